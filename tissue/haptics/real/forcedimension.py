"""Adapters for devices of Force Dimension, which use the package forcedimension-core.

The package forcedimension-core loads the vendor's library at run time. In its version 1.0.0, every
function takes the number of the device, fills a buffer, and returns -1 for an error. Positions are
in m. The columns of a rotation matrix are the axes of the handle. The axis x points towards the
user, y to the right of the user, and z up.
"""

from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real.adapter import FoundDevice, HardwareAdapter, HardwareSample
from tissue.motion.quaternion import NOTHING, UPRIGHT, of_matrix

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

FAILED = -1
UNCHANGED = 1
"""Return value of a library function without new data; `FAILED` is the value for an error.

The library returns no new data if the last call was too recent (its TIMEGUARD).
"""
MOST_FAILURES = 100
"""Number of consecutive failed calls after which the device is treated as lost.

With two calls in each tick, the limit is reached after 50 ms. After the same time, the force of a
device that does not respond is removed in any case.
"""
MISSING = (
    "must be installed for a device of Force Dimension. Run pip install "
    "forcedimension-core with Python 3.11 or 3.12, and install the SDK of "
    "forcedimension.com"
)
_OPEN: Counter[int] = Counter()
"""Number of adapters that use an open device, keyed by the library's number of the device."""


class ForceDimensionAdapter(HardwareAdapter):
    """Adapter for a device of Force Dimension without rotational motors, such as the omega.6.

    Each call queries the device over USB and returns within a fraction of a millisecond. The calls
    therefore run in the thread of the loop. If the device has a wrist without motors, the
    orientation of the wrist is read.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` is the serial number; it is empty for the
        first device.

    Raises
    ------
    InputError
        If the address is not a number.
    """

    name = "forcedimension"
    has_motors = False
    """True if the wrist of the device has motors, so that the device can apply torque."""

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        super().__init__(hardware)
        if self._given and not (self._given.isascii() and self._given.isdigit()):
            raise InputError(
                "hardware.address",
                "be a serial number",
                self._given,
                "leave it out for the first device",
            )
        self._dhd: Any = None
        self._id = FAILED
        self._has_wrist = False
        self._failures = 0
        self._position = [0.0] * 3
        self._velocity = [0.0] * 3
        self._spin = [0.0] * 3
        self._matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the connected devices of this kind, or the reason why there are none.

        Each device is opened for a moment.
        """
        try:
            dhd = _library()
        except InputError as error:
            # This class and `SigmaAdapter` need the same library. Only one of them reports that it
            # is missing.
            return [] if cls.has_motors else cls.missing(error)
        found = []
        for index in range(max(dhd.getDeviceCount(), 0)):
            if (number := dhd.openID(index)) == FAILED:
                found += cls.missing(_refused(dhd), f"device {index}")
                continue
            try:
                if bool(dhd.hasActiveWrist(number)) != cls.has_motors:
                    continue
                serial = str(dhd.getSerialNumber(number))
                model = dhd.getSystemName(number) or "unknown model"
            finally:
                if not _OPEN[number]:  # closing would end another adapter's run
                    dhd.close(number)
            if address in ("", serial):
                found.append(cls.found(serial, model))
        # The two classes search with the same library. Only one of them reports that nothing is
        # connected.
        if not found and not cls.has_motors:
            return cls.missing("a device must be connected, got none. Check power and cable")
        return found

    def open(self) -> None:
        """Open the device, limit its force, and switch its motors on."""
        dhd = _library()
        number = dhd.openSerial(int(self._given)) if self._given else dhd.open()
        if number == FAILED:
            raise InputError(_refused(dhd))
        self._dhd = dhd
        self._id = number
        self._failures = 0
        _OPEN[number] += 1
        if bool(dhd.hasActiveWrist(number)) != self.has_motors:
            other = "forcedimension" if self.has_motors else "sigma-7"
            raise InputError(
                "device",
                f"be {other} for this hardware",
                f"{self.name} for {dhd.getSystemName(number)}",
                f"set device = {other}",
            )
        self._has_wrist = bool(dhd.hasWrist(number))
        answers = [dhd.setMaxForce(self.limits.force_limit_N, number)]
        if self.has_motors:
            answers.append(dhd.setMaxTorque(self.limits.torque_limit_Nm, number))
        if FAILED in answers or dhd.enableForce(True, number) == FAILED:
            raise InputError(_refused(dhd))

    def poll(self) -> HardwareSample | None:
        """Return the newest pose; None if the device was not queried again or did not answer."""
        dhd = self._dhd
        number = self._id
        if self._has_wrist:
            answer = dhd.getPositionAndOrientationFrame(self._position, self._matrix, number)
        else:
            answer = dhd.getPosition(self._position, number)
        self._count(answer)
        if answer in (FAILED, UNCHANGED):
            return None
        # The two velocity calls fail until there are two positions within their time window. Until
        # then the velocity is set to zero.
        moves = dhd.getLinearVelocity(self._velocity, number) != FAILED
        turns = self._has_wrist and dhd.getAngularVelocityRad(self._spin, number) != FAILED
        (x, y, z) = self._position
        (vx, vy, vz) = self._velocity
        (wx, wy, wz) = self._spin
        return HardwareSample(
            (x, y, z),
            (vx, vy, vz) if moves else NOTHING,
            of_matrix(self._matrix) if self._has_wrist else UPRIGHT,
            (wx, wy, wz) if turns else NOTHING,
            # The vendor's bit mask has 32 bits, like the mask of `HardwareSample`.
            dhd.getButtonMask(number) & 0xFFFFFFFF,
        )

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Apply a force, and a torque if the wrist has motors, until the next call."""
        torque = torque_Nm.tolist() if self.has_motors else NOTHING
        self._count(self._dhd.setForceAndTorque(force_N.tolist(), torque, self._id))

    def close(self) -> None:
        """Switch the motors off and close the device, unless another adapter uses it."""
        dhd = self._dhd
        self._dhd = None
        if dhd is None:
            return
        _OPEN[self._id] -= 1
        calls = [lambda: dhd.setForceAndTorque(NOTHING, NOTHING, self._id)]
        if not _OPEN[self._id]:
            calls += [lambda: dhd.enableForce(False, self._id), lambda: dhd.close(self._id)]
        for call in calls:
            with suppress(Exception):
                call()

    def _count(self, answer: int) -> None:
        """Count consecutive failed calls, and raise an error if the device does not answer."""
        self._failures = self._failures + 1 if answer == FAILED else 0
        if self._failures >= MOST_FAILURES:
            raise DeviceError(_refused(self._dhd))


class SigmaAdapter(ForceDimensionAdapter):
    """Adapter for a device of Force Dimension with a motorised wrist, such as the sigma.7.

    The device can also apply torque.
    """

    name = "sigma-7"
    has_motors = True


def _library() -> Any:
    """Return the module with the vendor's functions for a single device."""
    try:
        from forcedimension_core import dhd
    except Exception as error:
        # ImportError without the vendor's library, other errors for a damaged one
        is_missing = isinstance(error, ModuleNotFoundError)
        what = "forcedimension-core" if is_missing else "the SDK of forcedimension.com"
        raise InputError(f"{what} {MISSING}") from None
    return dhd


def _refused(dhd: Any) -> str:
    """Return a sentence that describes the last error of the library."""
    remedy = "check power and cable, and that no other program uses the device"
    return str(InputError("the device", "answer", dhd.errorGetLastStr(), remedy))
