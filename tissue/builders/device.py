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
    return scene.device != "none" and DEVICES[scene.device].is_real


def opened_device(scene: Scene) -> Device | None:
    """A new device: of its adapter, or as `tissue.register.device` was given it; None for one that is simulated.

    Raises
    ------
    InputError
        If what was made is no device.
    """
    if not opens_device(scene):
        return None
    entry = DEVICES[scene.device]
    x, y, z = motion_of(scene, step_s=TICK_S).sweep_m()[0].tolist()
    if entry.adapter is not None:
        from tissue.hardware.mapped import MappedDevice

        return MappedDevice(loaded(entry.adapter)(scene.hardware), scene.hardware, start_m=(x, y, z))
    assert entry.make is not None
    device = loaded(entry.make)((x, y, z))
    if missing := [name for name in ("read", "command") if not callable(getattr(device, name, None))]:
        raise InputError(
            f"device must have read and command, got {type(device).__name__} without {' and '.join(missing)} for "
            f"{scene.device}: see `tissue.haptics.device.device.Device`"
        )
    return device
