"""Interface of adapters for real haptic devices, and results of a device search."""

from dataclasses import dataclass
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from meshes.base.arrays import Array
from tissue.haptics.device.device import DeviceParameters
from tissue.motion.quaternion import Quaternion, Triple

__all__ = ["FoundDevice", "HardwareAdapter", "HardwareSample"]


class HardwareSample(NamedTuple):
    """Newest sample of a device, in the device's own frame and SI units."""

    position_m: Triple
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    spin_rad_s: Triple = (0.0, 0.0, 0.0)
    buttons: int = 0
    """Bit i is set while button i is held."""


class HardwareAdapter(Protocol):
    """Real device in its own frame; a `MappedDevice` turns it into a `Device`.

    Entering the adapter opens the device. Leaving it removes all force and closes the device.
    ``close`` removes all force by other means than ``push`` and may be called from another thread.

    Attributes
    ----------
    limits
        Limits of the device, used to judge the loop and to limit forces.
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
        """Return the newest sample; None if there is no new one since the last call."""

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Play a force and a torque on the hand, in the device's frame, until the next call."""

    def close(self) -> None:
        """Remove all force from the device."""


@dataclass(frozen=True, kw_only=True)
class FoundDevice:
    """Device found by a search, or the reason that its adapter cannot search.

    Attributes
    ----------
    name
        Value of a scene's key ``device``.
    where
        Address, serial number or path of the library; empty without a device.
    detail
        Model and firmware, as stated by the device.
    limits
        Limits of the device; None without a device.
    problem
        One sentence with the missing part and its source; empty if the device can be opened.
    """

    name: str
    where: str = ""
    detail: str = ""
    limits: DeviceParameters | None = None
    problem: str = ""
