"""What an adapter of a real haptic device is, and what a search for devices finds."""

from dataclasses import dataclass
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from meshes.base.arrays import Array
from tissue.haptics.device.device import DeviceParameters
from tissue.motion.quaternion import Quaternion, Triple

__all__ = ["FoundDevice", "HardwareAdapter", "HardwareSample"]


class HardwareSample(NamedTuple):
    """The newest sample of a device, in the device's own frame as SI units."""

    position_m: Triple
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    spin_rad_s: Triple = (0.0, 0.0, 0.0)
    buttons: int = 0
    """Bit i is set while button i is held."""


class HardwareAdapter(Protocol):
    """A real device in its own frame; a `MappedDevice` makes a `Device` of it.

    Entering opens it; leaving takes all force off it and closes it. ``close`` takes all force off
    it by other means than ``push`` and may be called from another thread.

    Attributes
    ----------
    limits
        What the device can do, by which the loop is judged and forces are limited.
    """

    limits: DeviceParameters

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def poll(self) -> HardwareSample | None:
        """The newest sample; None where none came since the last call."""

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Play a force and a torque on the hand, in the device's frame, until the next call."""

    def close(self) -> None:
        """Take all force off the device."""


@dataclass(frozen=True, kw_only=True)
class FoundDevice:
    """A device that was found, or why its adapter cannot look for it.

    Attributes
    ----------
    name
        What a scene's ``device`` is set to.
    where
        Address, serial number or path of the library; empty where nothing was found.
    detail
        Model and firmware, as the device states them.
    limits
        What it can do; None where nothing was found.
    problem
        One sentence of what is missing and how to get it; empty where the device can be opened.
    """

    name: str
    where: str = ""
    detail: str = ""
    limits: DeviceParameters | None = None
    problem: str = ""
