"""The real device that a scene names, where what was registered opens one."""

from meshes.base.errors import InputError
from tissue.builders.registry import motion_of
from tissue.haptics.device.device import Device
from tissue.models.tissue_model import TICK_S
from tissue.scene.named_parts import loaded
from tissue.scene.registry import DEVICES
from tissue.scene.scene import Scene

__all__ = ["opened_device", "opens_device"]


def opens_device(scene: Scene) -> bool:
    """Whether a scene names a device whose real one can be opened."""
    return scene.device != "none" and DEVICES[scene.device].make is not None


def opened_device(scene: Scene) -> Device | None:
    """A new device as `tissue.register.device` was given it; None for a simulated one, or a scene without a device.

    Raises
    ------
    InputError
        If what was made is no device.
    """
    make = DEVICES[scene.device].make if opens_device(scene) else None
    if make is None:
        return None
    x, y, z = motion_of(scene, step_s=TICK_S).sweep_m()[0].tolist()
    device = loaded(make)((x, y, z))
    if missing := [name for name in ("read", "command") if not callable(getattr(device, name, None))]:
        raise InputError(
            f"device must have read and command, got {type(device).__name__} without {' and '.join(missing)} for "
            f"{scene.device}: see `tissue.haptics.device.device.Device`"
        )
    return device
