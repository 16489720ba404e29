"""Adapter for 3D Systems' Touch devices with pyOpenHaptics.

The package loads the vendor's OpenHaptics at run time. Facts from pyOpenHaptics 1.0.1: a transform
is in mm, with the axes of the handle in its first three rows and the position in the fourth. x
points right, y up, z to the hand. The library calls a function in its own thread, a thousand times
a second. The device may be read or driven only inside this function. This thread and the loop's
thread share a few attributes, each replaced as a whole. The class HapticDevice of the package does
not report a missing device, so that its functions are called one by one.

All devices of a process share the scheduler of the library. The first device starts it, and the
last one stops it. The package opens a frame of the current device. Each scheduled function
therefore first makes its own device current.
"""

import threading
from collections import deque
from contextlib import redirect_stdout, suppress
from io import StringIO
from time import perf_counter, sleep
from types import ModuleType
from typing import TYPE_CHECKING, Any

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real.adapter import FoundDevice, HardwareAdapter, HardwareSample
from tissue.motion.quaternion import of_matrix, turn_between

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

__all__ = ["OpenHapticsAdapter"]


USUAL = "Default Device"
"""Name of a single device in the vendor's configuration."""
NONE = (None, 0x0104, 0xFFFFFFFF)
"""Values returned in place of a device: none, HD_BAD_HANDLE and HD_INVALID_HANDLE."""
HELD_S = 0.05
"""Longest time for which a force is played without a new one [s].

It is the time of the network protocol, after which a device removes its force by itself.
"""
REST_S = 0.05
"""Longest time for the vendor's thread to play zero at the end [s]: 50 of its calls."""
ROUND_S = 5e-3
"""Time in which the vendor's thread calls the functions of all devices at least once [s].

It calls them a thousand times a second. Five periods allow for a busy machine.
"""
WINDOW = 10
"""Number of calls of the vendor's thread over which velocities are computed, 10 ms.

An encoder step of a Touch (0.055 mm) changes the velocity by 5.5 mm/s, instead of 55 mm/s.
"""
MISSING = (
    "must be installed for a Touch device, got none. Run pip install pyOpenHaptics, "
    "and OpenHaptics with the "
    "device's driver from 3dsystems.com"
)
_OPEN: dict[int, str] = {}
"""Names of the devices that this process has open, by the library's number."""
_OPENING = threading.Lock()


class OpenHapticsAdapter(HardwareAdapter):
    """Touch, Touch X or Omni: pose in six degrees of freedom, force in three.

    Parameters
    ----------
    hardware
        Its ``address`` is the name of the device in the vendor's setup; empty for a single device.
    """

    name = "openhaptics"

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        super().__init__(hardware)
        self._hd: Any = None
        self._id = 0
        self._callback: object = None  # must be kept: the library does not hold a reference
        self._sample: HardwareSample | None = None
        self._taken: HardwareSample | None = None
        self._force: tuple[list[float], float] = ([0.0, 0.0, 0.0], 0.0)  # with its time [s]
        self._past: deque[tuple[float, HardwareSample]] = deque(maxlen=WINDOW)
        self._problem = ""
        self._ended = True
        self._rests = threading.Event()

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the device of that name, or the reason for none; it is opened for a moment."""
        name = address or USUAL
        if name in _OPEN.values():  # opening and closing it again would end the run that uses it
            return [cls.found(name, "in use by this program")]
        try:
            hd = _library()[0]
            with redirect_stdout(StringIO()):
                number = _opened(hd, name)
                try:
                    return [cls.found(name, f"{hd.get_vendor()} {hd.get_model()}")]
                finally:
                    hd.close_device(number)
        except InputError as error:
            return cls.missing(error)

    def open(self) -> None:
        """Open the device, and schedule its function in the vendor's thread."""
        hd, scheduling = _library()
        name = self._given or USUAL
        self._sample = None
        self._taken = None
        self._problem = ""
        self._past.clear()
        with redirect_stdout(StringIO()):  # the package prints progress
            number = _opened(hd, name)
            self._hd = hd
            self._id = number
            self._ended = False
            with _OPENING:
                is_first = not _OPEN
                _OPEN[number] = name
            self._callback = scheduling.hd_callback(self._serve)
            hd.enable_force()
            if is_first:
                hd.start_scheduler()
            scheduling.hdAsyncSheduler(self._callback)

    def poll(self) -> HardwareSample | None:
        """Return the newest pose of the vendor's thread; None if it has not changed."""
        if self._problem:
            raise DeviceError(self._problem)
        sample = self._sample
        if sample is self._taken:
            return None
        self._taken = sample
        return sample

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Set the force of the vendor's thread until the next call, or for `HELD_S`.

        Torque is not played, because the device has no motors for it.
        """
        self._force = (force_N.tolist(), perf_counter())

    def close(self) -> None:
        """Play zero once more in the vendor's thread, and close the device.

        The last device stops the thread.
        """
        if self._ended:
            return
        self._rests.clear()
        self._ended = True
        hd = self._hd
        self._rests.wait(REST_S)
        self._hd = None
        with _OPENING:
            _OPEN.pop(self._id, None)
            is_last = not _OPEN
        if is_last:
            with suppress(Exception):
                hd.stop_scheduler()
        else:
            # wait until another device is current, so that no frame is opened for this device
            sleep(ROUND_S)
        with suppress(Exception):
            hd.close_device(self._id)

    def _serve(self) -> None:
        """Read and drive the device, in the vendor's thread.

        An exception would end that thread silently.
        """
        try:
            hd = self._hd
            now = perf_counter()
            if hd is None:
                return
            # The package opens a frame of the current device, which may be another one.
            current = hd.get_current_device()
            if current != self._id:
                hd.end_frame(current)
                hd.begin_frame(self._id)
            self._sample = self._read(hd.get_transform(), hd.get_buttons(), now)
            (force, pushed) = self._force
            ended = self._ended
            hd.set_force(force if now - pushed <= HELD_S and not ended else [0.0, 0.0, 0.0])
            if ended:
                self._hd = None
                self._rests.set()
        except Exception as error:
            failed = f"{type(error).__name__} ({error})"
            self._problem = str(
                InputError("the device", "answer", failed, "check its cable and driver")
            )

    def _read(self, transform: Any, buttons: int, now: float) -> HardwareSample:
        """Return a sample with velocities over the last calls."""
        x, y, z = (1e-3 * transform[3][axis] for axis in range(3))
        rows = [[transform[axis][row] for axis in range(3)] for row in range(3)]
        sample = HardwareSample((x, y, z), quaternion=of_matrix(rows), buttons=buttons)
        before, oldest = self._past[0] if self._past else (now, sample)
        self._past.append((now, sample))
        # The first call, or a coarse clock: no time has passed.
        if now <= before:
            return sample
        rate = 1.0 / (now - before)
        ax, ay, az = oldest.position_m
        wx, wy, wz = turn_between(oldest.quaternion, sample.quaternion)
        return sample._replace(
            velocity_m_s=(rate * (x - ax), rate * (y - ay), rate * (z - az)),
            spin_rad_s=(rate * wx, rate * wy, rate * wz),
        )


def _opened(hd: Any, name: str) -> int:
    """Return the number of a device that was opened by its name."""
    number: int | None = hd.init_device(name)
    if number is None or number in NONE:
        raise InputError(
            f"a device named {name}",
            "be connected",
            "none",
            "check cable, power and the vendor's setup, by which it has that name",
        )
    return number


def _library() -> tuple[ModuleType, ModuleType]:
    """Return the modules of the package for device access and for scheduling."""
    try:
        from pyOpenHaptics import hd, hd_callback
    except (ImportError, OSError, NameError) as error:
        # OSError without the vendor's library, NameError on macOS, which has no library
        is_missing = isinstance(error, ModuleNotFoundError)
        what = "pyOpenHaptics" if is_missing else "OpenHaptics of 3dsystems.com"
        raise InputError(f"{what} {MISSING}") from None
    return hd, hd_callback
