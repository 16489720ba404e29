"""3D Systems' Touch devices by pyOpenHaptics, which loads the vendor's OpenHaptics at run time.

Read in pyOpenHaptics 1.0.1: a transform is in mm, with the axes of the handle in its first three
rows and the position in the fourth; x points right, y up, z to the hand. The library calls a
function in a thread of its own, a thousand times a second, and only inside it may the device be
read or driven. That thread and the loop's share a few attributes, each replaced whole. The class
HapticDevice of the package does not report a device that is missing, so its functions are called
one by one.

All devices of a process share the library's scheduler: the first one starts it and the last one
stops it. The package opens a frame of whichever device is current, so each function that is called
makes its own device current first.
"""

import threading
from collections import deque
from contextlib import redirect_stdout, suppress
from io import StringIO
from time import perf_counter, sleep
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Self

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceError, DeviceParameters, device_parameters
from tissue.haptics.real.adapter import FoundDevice, HardwareSample
from tissue.motion.quaternion import Triple, of_matrix, turn_between

if TYPE_CHECKING:
    from tissue.scene.hardware import Hardware

__all__ = ["OpenHapticsAdapter"]

USUAL = "Default Device"
"""Name that the vendor's configuration gives a single device."""
NONE = (None, 0x0104, 0xFFFFFFFF)
"""What is returned in place of a device."""
HELD_S = 0.05
"""How long a force is played without another one [s]."""
REST_S = 0.05
"""How long an end waits for the vendor's thread to have played zero [s]."""
ROUND_S = 5e-3
"""Time in which the vendor's thread has called the functions of all devices once more [s]."""
WINDOW = 10
"""Calls of the vendor's thread over which velocities are taken, 10 ms."""
MISSING = (
    "must be installed for a Touch device, got none: pip install 'tissue-sim[openhaptics]', "
    "and OpenHaptics with the "
    "device's driver from 3dsystems.com"
)
NO_DEVICE = "check cable, power and the vendor's setup, by which it has that name"


_OPEN: dict[int, str] = {}
"""Names of the devices that this process has open, by the library's number."""
_OPENING = threading.Lock()


class OpenHapticsAdapter:
    """A Touch, Touch X or Omni: the pose with six degrees of freedom, force with three.

    Parameters
    ----------
    hardware
        Its ``address`` is the device's name in the vendor's setup; empty for the one that is alone.
    """

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        self._name = (hardware.address if hardware else "") or USUAL
        self.limits: DeviceParameters = device_parameters("openhaptics")
        self._hd: Any = None
        self._id = 0
        self._callback: object = None  # the library keeps none, and would call what was freed
        self._sample: HardwareSample | None = None
        self._taken: HardwareSample | None = None
        self._force: tuple[list[float], float] = ([0.0, 0.0, 0.0], 0.0)  # and when it was pushed
        self._past: deque[tuple[float, HardwareSample]] = deque(maxlen=WINDOW)
        self._problem = ""
        self._ended = True
        self._rests = threading.Event()

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """The device of that name, or why there is none; it is opened for a moment."""
        name = address or USUAL
        try:
            hd = _library()[0]
        except InputError as error:
            return [FoundDevice(name="openhaptics", problem=str(error))]
        if name in _OPEN.values():  # to open it again and close it would end the other one's run
            detail = "in use by this program"
            return [
                FoundDevice(
                    name="openhaptics",
                    where=name,
                    detail=detail,
                    limits=device_parameters("openhaptics"),
                )
            ]
        with redirect_stdout(StringIO()):
            number = hd.init_device(name)
            if number in NONE:
                problem = f"a device named {name} must be connected, got none: {NO_DEVICE}"
                return [FoundDevice(name="openhaptics", problem=problem)]
            try:
                detail = f"{hd.get_vendor()} {hd.get_model()}"
            finally:
                hd.close_device(number)
        return [
            FoundDevice(
                name="openhaptics",
                where=name,
                detail=detail,
                limits=device_parameters("openhaptics"),
            )
        ]

    def __enter__(self) -> Self:
        hd, scheduling = _library()
        self._sample = None
        self._taken = None
        self._problem = ""
        self._past.clear()
        with redirect_stdout(StringIO()):  # the package prints what it does
            number = hd.init_device(self._name)
            if number in NONE:
                raise InputError(f"a device named {self._name}", "be connected", "none", NO_DEVICE)
            self._hd = hd
            self._id = number
            self._ended = False
            with _OPENING:
                is_first = not _OPEN
                _OPEN[number] = self._name
            self._callback = scheduling.hd_callback(self._serve)
            try:
                hd.enable_force()
                if is_first:
                    hd.start_scheduler()
                scheduling.hdAsyncSheduler(self._callback)
            except BaseException:
                self.close()
                raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def poll(self) -> HardwareSample | None:
        """The newest pose of the vendor's thread; None where it has none since the last call.

        Raises
        ------
        DeviceError
            If the vendor's thread has failed.
        """
        if self._problem:
            raise DeviceError(self._problem)
        sample = self._sample
        if sample is self._taken:
            return None
        self._taken = sample
        return sample

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Let the vendor's thread play a force until the next one, or for `HELD_S`; no motor
        plays a torque.
        """
        self._force = (force_N.tolist(), perf_counter())

    def close(self) -> None:
        """Let the vendor's thread play zero once more, and close the device; the last device
        stops the thread.
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
            # until another device is current, so that no frame is opened of this one
            sleep(ROUND_S)
        with suppress(Exception):
            hd.close_device(self._id)

    def _serve(self) -> None:
        """Read and drive the device; called in the vendor's thread, which an exception would end
        without a word.
        """
        try:
            hd = self._hd
            now = perf_counter()
            if hd is None:
                return
            self._make_current(hd)
            self._sample = self._read(hd.get_transform(), hd.get_buttons(), now)
            (force, pushed) = self._force
            ended = self._ended
            hd.set_force(force if now - pushed <= HELD_S and not ended else [0.0, 0.0, 0.0])
            if ended:
                self._hd = None
                self._rests.set()
        except Exception as error:
            self._problem = (
                f"the device must answer, got {type(error).__name__} ({error}): check its cable "
                "and driver"
            )

    def _make_current(self, hd: Any) -> None:
        """Leave the frame of another device, which the package has opened, for one of this
        device.
        """
        current = hd.get_current_device()
        if current != self._id:
            hd.end_frame(current)
            hd.begin_frame(self._id)

    def _read(self, transform: Any, buttons: int, now: float) -> HardwareSample:
        x, y, z = (1e-3 * transform[3][axis] for axis in range(3))
        rows = [[transform[axis][row] for axis in range(3)] for row in range(3)]
        sample = HardwareSample((x, y, z), quaternion=of_matrix(rows), buttons=buttons)
        before, oldest = self._past[0] if self._past else (now, sample)
        self._past.append((now, sample))
        if now <= before:
            return sample
        share = 1.0 / (now - before)
        ax, ay, az = oldest.position_m
        velocity: Triple = (share * (x - ax), share * (y - ay), share * (z - az))
        wx, wy, wz = turn_between(oldest.quaternion, sample.quaternion)
        return sample._replace(
            velocity_m_s=velocity, spin_rad_s=(share * wx, share * wy, share * wz)
        )


def _library() -> tuple[ModuleType, ModuleType]:
    """The modules of the package that use a device, and that schedule a function."""
    try:
        from pyOpenHaptics import hd, hd_callback
    except (
        ImportError,
        OSError,
        NameError,
    ) as error:  # OSError without the vendor's, NameError on macOS, which has none
        what = (
            "pyOpenHaptics"
            if isinstance(error, ModuleNotFoundError)
            else "OpenHaptics of 3dsystems.com"
        )
        raise InputError(f"{what} {MISSING}") from None
    return hd, hd_callback
