"""Adapter for the Touch devices of 3D Systems, which uses the package pyOpenHaptics.

The package loads the vendor's library OpenHaptics at run time. The following applies to
pyOpenHaptics 1.0.1. A pose is a matrix with the axes of the handle in its first three rows and the
position [mm] in the fourth row. The axis x points to the right, y up, and z towards the user. The
library calls a scheduled function a thousand times a second in its own thread. Only this function
may read the device and set its force. The thread of the library and the thread of the loop share a
few attributes, and each attribute is replaced as a whole. The functions of the package are called
directly, because its class HapticDevice does not report a missing device.

A process can use only one device at a time, because the package always addresses the device that
was opened last.
"""

import threading
from collections import deque
from contextlib import redirect_stdout, suppress
from io import StringIO
from time import perf_counter
from types import ModuleType
from typing import TYPE_CHECKING, Any

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real.adapter import FoundDevice, HardwareAdapter, HardwareSample
from tissue.motion.quaternion import of_matrix, turn_between

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

USUAL = "Default Device"
"""Default name of a device in the vendor's configuration."""
NONE = (None, 0x0104, 0xFFFFFFFF)
"""Device numbers that mean that no device was opened.

They are None, HD_BAD_HANDLE and HD_INVALID_HANDLE.
"""
HELD_S = 0.05
"""Longest time for which a force is applied without a new command [s].

In the network protocol of this package, a device that receives no packets removes its force after
the same time.
"""
REST_S = 0.05
"""Longest wait at the end until the vendor's thread has set zero force [s]: 50 of its calls."""
WINDOW = 10
"""Number of calls of the vendor's thread, 10 ms, over which velocities are computed.

An encoder step of a Touch (0.055 mm) then changes the velocity by 5.5 mm/s. Computed over one call,
the change would be 55 mm/s.
"""
MISSING = (
    "must be installed for a Touch device. Run pip install pyOpenHaptics, "
    "and install OpenHaptics with the driver of the device from 3dsystems.com"
)
_OPEN: list[str] = []
"""Name of the device that this process has opened, if any."""


class OpenHapticsAdapter(HardwareAdapter):
    """Adapter of a Touch, Touch X or Omni: pose in six degrees of freedom, force in three.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` is the name of the device in the vendor's
        configuration; it is empty for the default device.
    """

    name = "openhaptics"

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        super().__init__(hardware)
        self._hd: Any = None
        self._id = 0
        self._callback: object = None  # kept, because the library does not hold a reference
        self._sample: HardwareSample | None = None
        self._taken: HardwareSample | None = None
        self._force: tuple[list[float], float] = ([0.0, 0.0, 0.0], 0.0)  # with its time [s]
        self._past: deque[tuple[float, HardwareSample]] = deque(maxlen=WINDOW)
        self._problem = ""
        self._ended = True
        self._rests = threading.Event()

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the device with the name ``address``, or the reason why there is none.

        The device is opened for a moment.
        """
        name = address or USUAL
        if name in _OPEN:  # opening and closing it would end the run that uses it
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
        """Open the device, and schedule the function that reads and drives it."""
        hd, scheduling = _library()
        name = self._given or USUAL
        if _OPEN:
            raise InputError(
                "openhaptics",
                "have only one open device in a program",
                f"{name} as a second device",
                f"close {_OPEN[0]} first",
            )
        self._sample = None
        self._taken = None
        self._problem = ""
        self._past.clear()
        with redirect_stdout(StringIO()):  # the package prints progress
            number = _opened(hd, name)
            self._hd = hd
            self._id = number
            self._ended = False
            _OPEN.append(name)
            self._callback = scheduling.hd_callback(self._serve)
            hd.enable_force()
            hd.start_scheduler()
            scheduling.hdAsyncSheduler(self._callback)

    def poll(self) -> HardwareSample | None:
        """Return the newest pose that the vendor's thread has read; None if it is unchanged."""
        if self._problem:
            raise DeviceError(self._problem)
        sample = self._sample
        if sample is self._taken:
            return None
        self._taken = sample
        return sample

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Set the force that the device applies until the next call, at most for `HELD_S`.

        Torque is ignored, because the device has no rotational motors.
        """
        self._force = (force_N.tolist(), perf_counter())

    def close(self) -> None:
        """Set zero force in the vendor's thread, stop this thread, and close the device."""
        if self._ended:
            return
        self._rests.clear()
        self._ended = True
        hd = self._hd
        self._rests.wait(REST_S)
        self._hd = None
        _OPEN.clear()
        for call in (hd.stop_scheduler, lambda: hd.close_device(self._id)):
            with suppress(Exception):
                call()

    def _serve(self) -> None:
        """Read and drive the device, in the vendor's thread.

        An exception would end the vendor's thread silently. It is therefore stored, and `poll`
        raises it.
        """
        try:
            hd = self._hd
            now = perf_counter()
            if hd is None:
                return
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
        """Return a sample with velocities computed from the poses of the last calls."""
        x, y, z = (1e-3 * transform[3][axis] for axis in range(3))
        rows = [[transform[axis][row] for axis in range(3)] for row in range(3)]
        sample = HardwareSample((x, y, z), quaternion=of_matrix(rows), buttons=buttons)
        before, oldest = self._past[0] if self._past else (now, sample)
        self._past.append((now, sample))
        # On the first call, or with a coarse clock, no time has passed.
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
    """Open a device by its name, and return its number."""
    number: int | None = hd.init_device(name)
    if number is None or number in NONE:
        raise InputError(
            f"a device named {name}",
            "be connected",
            "none",
            "check cable, power and the name in the vendor's setup",
        )
    return number


def _library() -> tuple[ModuleType, ModuleType]:
    """Return the two modules of pyOpenHaptics for device access and for scheduling."""
    try:
        from pyOpenHaptics import hd, hd_callback
    except (ImportError, OSError, NameError) as error:
        # OSError without the vendor's library, NameError on macOS, which has no library
        is_missing = isinstance(error, ModuleNotFoundError)
        what = "pyOpenHaptics" if is_missing else "OpenHaptics of 3dsystems.com"
        raise InputError(f"{what} {MISSING}") from None
    return hd, hd_callback
