"""Interface of adapters for real haptic devices, and results of a device search."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import Quaternion, Triple
from tissue.motion.replay import read_replay
from tissue.scene.registry import DEVICES

if TYPE_CHECKING:
    from tissue.scene.hardware import Hardware

__all__ = [
    "FoundDevice",
    "HardwareAdapter",
    "HardwareSample",
    "RecordedAdapter",
    "adapter_class",
    "devices",
]


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


ADAPTERS = {
    "haply": ("haply", "HaplyAdapter"),
    "forcedimension": ("forcedimension", "ForceDimensionAdapter"),
    "sigma-7": ("forcedimension", "SigmaAdapter"),
    "openhaptics": ("openhaptics", "OpenHapticsAdapter"),
    "network": ("network", "NetworkAdapter"),
    "recorded": ("adapter", "RecordedAdapter"),
}
"""Module of this package and class that opens a real device, by the device's name."""


def adapter_class(name: str) -> Callable[..., Any]:
    """Return the class of the adapter that opens a device, called with the scene's `Hardware`."""
    module, attribute = ADAPTERS[name]
    found: Callable[..., Any] = getattr(import_module(f"tissue.haptics.real.{module}"), attribute)
    return found


def devices() -> list[FoundDevice]:
    """Return the real devices of this machine, and the reason for each kind without one.

    A search takes seconds: it opens each device for a moment and waits for one on the network.
    """
    found: list[FoundDevice] = []
    for name in DEVICES:
        if DEVICES[name].has_adapter and (find := getattr(adapter_class(name), "find", None)):
            found += find()
    return found


class RecordedAdapter:
    """Poses of a file, one for each call of `poll`; after the last one, the force fades.

    A run plays the poses at their recorded positions: its tool starts at the first pose. Unlike
    ``motion.kind = "replay"``, which moves the tool itself, the poses move the device. Coupling,
    prediction and commanded force are those for a hand with this motion.

    Parameters
    ----------
    hardware
        Its ``address`` is a file as for ``motion.file``, such as a run's trace.csv.

    Raises
    ------
    InputError
        If the file is missing, or does not contain poses.
    """

    bounds_itself = True
    """No reach is applied, because a file has no arm that bounds its positions."""

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        address = hardware.address if hardware else ""
        if not address:
            raise InputError(
                "hardware.address",
                "be a file of poses with device = recorded",
                "nothing",
                "use a run's trace.csv",
            )
        self.limits: DeviceParameters = device_parameters("recorded")
        self._samples = _samples(Path(address))
        self._next = 0

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """Return the file as a device, or the reason for none."""
        from tissue.scene.hardware import Hardware

        try:
            adapter = RecordedAdapter(Hardware(address=address))
        except InputError as error:
            return [FoundDevice(name="recorded", problem=str(error))]
        lasts = TICK_S * (len(adapter._samples) - 1)
        return [
            FoundDevice(
                name="recorded",
                where=address,
                detail=f"{lasts:g} s of poses",
                limits=adapter.limits,
            )
        ]

    def __enter__(self) -> Self:
        self._next = 0
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def poll(self) -> HardwareSample | None:
        """Return the pose of the next tick; None after the last one."""
        if self._next >= len(self._samples):
            return None
        self._next += 1
        return self._samples[self._next - 1]

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Ignore a force and a torque."""

    def close(self) -> None:
        """End the recording."""
        self._next = len(self._samples)


def _samples(path: Path) -> list[HardwareSample]:
    """Return the poses of a file at every tick, with their rates of change."""
    from scipy.spatial.transform import Rotation

    with names_of_caller({"motion.file": "hardware.address"}):
        motion = read_replay(path, step_s=TICK_S)
    tips = motion.sweep_m()
    turns = Rotation.from_matrix(motion.rotations()).as_quat()
    times = TICK_S * np.arange(len(tips), dtype=np.float64)
    played = RecordedDevice(times, tips, turns, rate_Hz=1.0 / TICK_S)
    samples = [played.read(time_s) for time_s in times.tolist()]
    return [
        HardwareSample(each.position_m, each.velocity_m_s, each.quaternion, each.spin_rad_s)
        for each in samples
        if each is not None
    ]
