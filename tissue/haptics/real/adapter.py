"""Adapters of real haptic devices: base class, recorded motion as device, device search."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self
from urllib.parse import SplitResult, urlsplit

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.base.hints import suggests_arguments
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import UPRIGHT, Quaternion, Triple
from tissue.motion.replay import read_replay
from tissue.scene.registry import DEVICES

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

ADAPTERS = {
    "haply": ("haply", "HaplyAdapter"),
    "forcedimension": ("forcedimension", "ForceDimensionAdapter"),
    "sigma-7": ("forcedimension", "SigmaAdapter"),
    "openhaptics": ("openhaptics", "OpenHapticsAdapter"),
    "network": ("network", "NetworkAdapter"),
    "recorded": ("adapter", "RecordedAdapter"),
}
"""Module and class that open a real device, keyed by the name of the device."""


class HardwareSample(NamedTuple):
    """Sample of a real device, in the frame of the device and in SI units."""

    position_m: Triple
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UPRIGHT
    spin_rad_s: Triple = (0.0, 0.0, 0.0)
    buttons: int = 0
    """Bit mask in which bit i is set while button i is held."""


@dataclass(frozen=True, kw_only=True)
class FoundDevice:
    """Device that a search has found, or the reason why the search has found no device.

    Attributes
    ----------
    name
        Value of a scene's key ``device``.
    where
        Address or serial number of the device, or path of the vendor's library; empty if no device
        was found.
    detail
        Model and firmware, as reported by the device.
    limits
        Limits of the device; None without a device.
    problem
        Sentence on the missing hardware or software and where to get it; empty if the device can be
        opened.
    """

    name: str
    where: str = ""
    detail: str = ""
    limits: DeviceParameters | None = None
    problem: str = ""


class HardwareAdapter(ABC):
    """Base class of adapters for real devices; poses are in the frame of the device.

    `MappedDevice` makes a `Device` from an adapter. An adapter is a context manager: entering it
    opens the device, and leaving it removes all force and closes the device. The method ``close``
    removes all force without calling ``push``. It may be called repeatedly, and from another
    thread.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` selects the device; it is empty for the
        default device.

    Attributes
    ----------
    limits
        Limits of the device, used to check the stability of the loop and to limit forces.
    releases
        Number of times that the adapter has removed the force by itself. After each removal, the
        force must increase from zero.
    """

    name: ClassVar[str]
    """Value of a scene's key ``device``."""
    limits: DeviceParameters
    releases: int = 0

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        self._given = hardware.address if hardware else ""
        self.limits = device_parameters(self.name)

    def __enter__(self) -> Self:
        try:
            self.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    @abstractmethod
    def open(self) -> None:
        """Open the device with zero force."""

    @abstractmethod
    def poll(self) -> HardwareSample | None:
        """Return the newest sample; None if there is no new sample since the last call.

        Raises
        ------
        DeviceError
            If the device is permanently lost.
        """

    @abstractmethod
    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Apply a force and a torque, in the device's frame, to the hand until the next call."""

    @abstractmethod
    def close(self) -> None:
        """Remove all force from the device and close it."""

    def happened(self) -> list[str]:
        """Return the events so far, as sentences."""
        return []

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the connected devices of this kind, or the reason why there are none."""
        return []

    @classmethod
    def found(cls, where: str, detail: str, problem: str = "") -> FoundDevice:
        """Return the description of a device that a search has found."""
        limits = device_parameters(cls.name)
        return FoundDevice(
            name=cls.name, where=where, detail=detail, limits=limits, problem=problem
        )

    @classmethod
    def missing(cls, problem: object, where: str = "") -> list[FoundDevice]:
        """Return a list with the reason why a search has found no device."""
        return [FoundDevice(name=cls.name, where=where, problem=str(problem))]


class RecordedAdapter(HardwareAdapter):
    """Device that returns the poses of a file, one pose for each call of `poll`.

    After the last pose, the force fades to zero. The tool of a run starts at the first recorded
    position. With this device, the poses move the device, and the coupling moves the tool.
    Coupling, prediction and force are computed as if a hand moved the device along the recorded
    poses. In contrast, ``motion.kind = "replay"`` moves the tool itself.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` is the path of a file with poses, such as
        the trace.csv of a run. All files that the scene key ``motion.file`` accepts are possible.

    Raises
    ------
    InputError
        If the file is missing, or does not contain poses.
    """

    name = "recorded"
    bounds_itself = True
    """True: the reach of the device is not checked, because a file has no arm."""

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        super().__init__(hardware)
        if not self._given:
            raise InputError(
                "hardware.address",
                "be given with device = recorded",
                "nothing",
                "give a file of poses, such as a run's trace.csv",
            )
        self._samples = _samples(Path(self._given))
        self._next = 0

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the file as a device, or the reason why it cannot be used."""
        from tissue.scene.coupling import Hardware

        try:
            adapter = cls(Hardware(address=address))
        except InputError as error:
            return cls.missing(error)
        lasts = TICK_S * (len(adapter._samples) - 1)
        return [cls.found(address, f"{lasts:g} s of poses")]

    def open(self) -> None:
        """Start at the first pose."""
        self._next = 0

    def poll(self) -> HardwareSample | None:
        """Return the pose of the next tick; None after the last pose."""
        if self._next >= len(self._samples):
            return None
        self._next += 1
        return self._samples[self._next - 1]

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Ignore the force and the torque, because a file has no motors."""

    def close(self) -> None:
        """End the recording."""
        self._next = len(self._samples)


def _samples(path: Path) -> list[HardwareSample]:
    """Return the poses of a file at every tick, with their velocities."""
    from scipy.spatial.transform import Rotation

    with names_of_caller({"motion.file": "hardware.address"}):
        motion = read_replay(path)
    tips = motion.sweep_m()
    # Velocities need two poses.
    if len(tips) < 2:
        raise InputError(
            "hardware.address",
            f"be a recording of at least {1e3 * TICK_S:g} ms",
            f"{path.name} with a single pose",
            "record a longer motion",
        )
    turns = Rotation.from_matrix(motion.rotations()).as_quat()
    times = TICK_S * np.arange(len(tips), dtype=np.float64)
    played = RecordedDevice(times, tips, turns)
    return [HardwareSample(*sample[1:]) for sample in map(played.read, times.tolist()) if sample]


def checked_url(
    address: str, schemes: tuple[str, ...], meant: str, usual: str, *, any_port: bool = False
) -> tuple[SplitResult, str, int]:
    """Return the parts of ``hardware.address`` as a URL, with its host and port.

    Port 0 means any free port of this computer, so it is valid only with `any_port`.

    Raises
    ------
    InputError
        If the address has another scheme, no host, no port, or a path.
    """
    try:
        parts = urlsplit(address)
        host = parts.hostname
        port = parts.port
    except ValueError:
        host = port = None
    has_port = port is not None and (port > 0 or any_port)
    if host and has_port and parts.scheme in schemes and not parts.path.strip("/"):
        assert port is not None
        return parts, host, port
    raise InputError("hardware.address", f"be {meant}", address, f"use {usual}")


def adapter_class(name: str) -> type[HardwareAdapter]:
    """Return the adapter class of a device; the class is called with a scene's `Hardware`."""
    module, attribute = ADAPTERS[name]
    found: type[HardwareAdapter] = getattr(
        import_module(f"tissue.haptics.real.{module}"), attribute
    )
    return found


@suggests_arguments
def devices() -> list[FoundDevice]:
    """Return the real devices of this computer.

    For each kind of device that is not found, the result contains the reason.

    The search takes some seconds, because it opens each device for a moment and waits for a device
    on the network.
    """
    found: list[FoundDevice] = []
    for name in DEVICES:
        if DEVICES[name].has_adapter:
            found += adapter_class(name).find()
    return found
