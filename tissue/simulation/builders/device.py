"""Real device that a scene names, if it is registered and can be opened."""

from meshes.base.errors import InputError
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import SafeDevice
from tissue.models.tissue_model import TICK_S
from tissue.scene.registry import DEVICES
from tissue.scene.scene import Scene
from tissue.simulation.builders.motions import motion_of

__all__ = ["opened_device", "opens_device", "require_stated_rate"]


def opens_device(scene: Scene) -> bool:
    """Return whether a scene names a real device that can be opened."""
    return scene.device is not None and DEVICES[scene.held.kind].is_real


def opened_device(scene: Scene) -> Device | None:
    """Open a new device, by its adapter or as registered with `tissue.register.device`.

    Returns None for a simulated device.

    Raises
    ------
    InputError
        If the object made has no `read` or `command` method.
    """
    if not opens_device(scene):
        return None
    entry = DEVICES[scene.held.kind]
    x, y, z = motion_of(scene, step_s=TICK_S).sweep_m()[0].tolist()
    if entry.has_adapter:
        from tissue.haptics.real.adapter import adapter_class
        from tissue.haptics.real.mapped import MappedDevice

        hardware = scene.held.hardware
        return MappedDevice(adapter_class(scene.held.kind)(hardware), hardware, start_m=(x, y, z))
    assert entry.make is not None
    device: Device = entry.make((x, y, z))
    if missing := [
        name for name in ("read", "command") if not callable(getattr(device, name, None))
    ]:
        raise InputError(
            "device",
            "have read and command",
            f"{type(device).__name__} without {' and '.join(missing)} for {scene.held.kind}",
            "see `tissue.haptics.device.device.Device`",
        )
    return device


def require_stated_rate(
    device: Device | SafeDevice, limits: DeviceParameters, *, remedy: str
) -> None:
    """Refuse a device slower than the constants used to judge its loop.

    A device states its rate [samples per second] in ``limits`` or ``parameters``. A device without
    either is assumed to have the constants' rate.

    Raises
    ------
    InputError
        If the device is slower than its constants.
    """
    held = device.device if isinstance(device, SafeDevice) else device
    for name in ("limits", "parameters"):
        stated = getattr(held, name, None)
        if isinstance(stated, DeviceParameters) and stated.rate_Hz < min(
            limits.rate_Hz, 1.0 / TICK_S
        ) * (1.0 - 1e-6):
            raise InputError(
                "device",
                f"give the {limits.rate_Hz:g} samples a second of its constants",
                f"{stated.rate_Hz:g} by {type(held).__name__}",
                remedy,
            )
