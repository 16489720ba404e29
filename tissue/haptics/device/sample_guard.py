"""Validation of device samples, and fading of the force while samples are not valid.

A sample is valid if a human hand could have moved the device to its pose.
"""

from math import ceil, dist, isfinite, nan, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.haptics.device.device import (
    Device,
    DeviceError,
    DeviceParameters,
    Reach,
    Sample,
    reach_of,
)
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import (
    UPRIGHT,
    Quaternion,
    is_nearly_unit,
    turn_between,
    unit,
)

MEMORY = 8.0
"""Number of samples over which `Roughness` averages the share of rough samples.

A jump or a blow causes two rough samples in a row, and thus a share of 0.23. Six rough samples give
a share above the limit `ROUGH`.
"""
STALE = 0.25
"""Weight of a repeated sample in the exponential mean of the share of rough samples.

With a weight of 0, the samples of a device at rest would never become valid again. A device at 250
Hz repeats each sample three times. With a weight of 1, noise of such a device would give a share of
only 0.25 and would not be detected. With a weight of 0.25, the share is 0.57.
"""
ROUGH = 0.5
SMOOTH = 0.05
"""Share of rough samples below which a signal is valid again.

A signal is treated as noise when the share exceeds `ROUGH`.
"""
SHORTEST_S = 2e-3
"""Lower bound of the time span of three samples in `Roughness` [s].

In a shorter time span, encoder steps and clock jitter would look like noise.
"""

Place = tuple[float, float, float, float, float]
"""Time [s] and up to four coordinates."""


class Roughness:
    """Detector of noise in a sequence of samples, based on the acceleration of the motion.

    The detector measures the deviation of a sample from the straight line between the previous and
    the next sample. For time steps T and an acceleration a, the deviation is at most a T^2 / 2. A
    sample is rough if its deviation is larger than this value with a = ``limit``. The signal is
    treated as noise when more than half of its last samples (exponential mean over 8 samples) are
    rough. The signal is valid again when less than a twentieth of its samples are rough. A jump, a
    lost sample, an encoder step or a blow makes at most two samples rough. White noise is detected
    if its standard deviation per axis is larger than about ``limit`` (1 ms)^2 / 4.

    Parameters
    ----------
    limit
        Largest acceleration of a valid motion, in the unit of the samples per s^2.

    Attributes
    ----------
    noisy
        True if the signal is noise.
    share
        Exponential mean of the share of rough samples.
    """

    def __init__(self, limit: float) -> None:
        # Three samples span 2 T, so that a T^2 / 2 is a span^2 / 8.
        self._limit = limit / 8.0
        self.noisy = False
        self.share = 0.0
        self._first: Place | None = None
        self._middle: Place | None = None

    def observe(self, time_s: float, x: float, y: float, z: float, w: float = 0.0) -> bool:
        """Process a sample with its time [s], and return True if the signal is noise."""
        first = self._first
        middle = self._middle
        if (
            middle is not None
            and x == middle[1]
            and y == middle[2]
            and z == middle[3]
            and w == middle[4]
        ):
            if self.share > 0.0:
                self._count(False, STALE / MEMORY)
            return self.noisy
        self._first = middle
        self._middle = (time_s, x, y, z, w)
        if first is None or middle is None:
            return False
        start, ax, ay, az, aw = first
        between, bx, by, bz, bw = middle
        span = time_s - start
        # Samples may have equal times. The middle sample is then treated as in the middle of the
        # time.
        part = (between - start) / span if span > 0.0 else 0.5
        dx = bx - ax - part * (x - ax)
        dy = by - ay - part * (y - ay)
        dz = bz - az - part * (z - az)
        dw = bw - aw - part * (w - aw)
        square = dx * dx + dy * dy + dz * dz + dw * dw
        span = span if span > SHORTEST_S else SHORTEST_S
        allowed = self._limit * span * span
        rough = square > allowed * allowed
        if rough or self.share > 0.0:
            self._count(rough, 1.0 / MEMORY)
        return self.noisy

    def _count(self, rough: bool, weight: float) -> None:
        self.share += weight * (rough - self.share)
        if self.share > ROUGH:
            self.noisy = True
        elif self.share < SMOOTH:
            self.noisy = False
            # Exactly zero, so that a quiet signal needs no further computation.
            if self.share < 1e-6:
                self.share = 0.0


MOST_EVENTS = 200
"""Largest number of listed changes between valid and invalid samples.

Without this limit, a device whose samples change between valid and invalid in every tick would fill
the memory and the report.
"""
NO_TORQUE = np.zeros(3)
SHAPES: tuple[tuple[int, ...], ...] = ((), (3,), (3,), (4,), (3,))
"""Shapes of the entries of a `Sample`: time, position, velocity, quaternion and spin."""
PLAIN = {float, int, np.float64}
"""Types of numbers in samples that are accepted without conversion; bool is not accepted."""
HALF_TURN = 1e-3
"""Largest difference of the first quaternion component from 1 that is treated as a half-turn.

The first component must be x. If a device gives w first, its start orientation looks like a
half-turn about x. Such a start is therefore listed in the events. The tolerance allows for a start
orientation of up to 5 degrees.
"""
UNIT = " (positions must be in metres)"
"""Hint in messages about a motion that is too fast or too large for a hand.

A possible cause is that the device reports positions in millimetres.
"""
W_FIRST = (
    "the first orientation is half a turn about x. A quaternion is (x, y, z, w); a "
    "device that gives w first starts with this orientation"
)


FASTEST_M_S = 5.0
FASTEST_RAD_S = 60.0
"""Largest speeds of a hand: `FASTEST_M_S` [m/s] and `FASTEST_RAD_S` [rad/s].

A sample is rejected if its speed is larger, or if its distance from the last valid sample requires
a larger speed.
"""
OLDEST_S = 2.5e-3
"""Default age above which a sample is treated as missing [s].

The value is suitable for a device that has a new sample in every tick.
"""
ROUGHEST_M_S2 = 2e3
ROUGHEST_RAD_S2 = 4e4
"""Largest accelerations of a handheld object: `ROUGHEST_M_S2` and `ROUGHEST_RAD_S2`.

The units are m/s^2 and rad/s^2.

Samples are treated as noise if they repeatedly require a larger acceleration. A hand, a contact and
a device's motors cause about 200 m/s^2. A blow causes 1000 m/s^2 for one or two ticks.
"""
FADE_S = 0.02
"""Time of the fade to zero without valid samples, and of the return to full force [s]."""


class SampleGuard:
    """Guard that validates device samples and limits the force that is computed from a sample.

    Call `validate_sample` with the device's sample. Then call `limit_force` with the force for a
    valid sample, or with None after an invalid sample. While samples are invalid, the last valid
    force fades linearly and is exactly zero after `FADE_S`. With valid samples, the force returns
    at the same rate. Forces are always bounded. A sample of a wrong type, or with a wrong number of
    entries, raises an error, because the cause is a mistake in the device class.

    Parameters
    ----------
    force_limit_N, torque_limit_Nm
        Largest magnitude of force and of torque. A torque limit of zero blocks all torque.
    oldest_s
        Age above which a sample is treated as missing [s]. The time of a sample may be later than
        the present time by at most the same value.

    Attributes
    ----------
    share
        Factor, 0 to 1, by which the last valid force is multiplied in this tick. The factor is
        below 1 while the force fades or returns.
    events
        Events, each with a time [s] and a sentence, at changes between valid and invalid samples
        and at changes of the kind of fault. Only the first 200 changes are listed.
    bad_ticks
        Number of invalid samples.
    reach
        Check that positions are within the reach of the device's arm; None for no check.
    """

    def __init__(
        self,
        *,
        force_limit_N: float,
        torque_limit_Nm: float = 0.0,
        oldest_s: float = OLDEST_S,
    ) -> None:
        self._oldest_s = oldest_s
        self._caps = (
            require_positive(
                "force_limit_N", force_limit_N, "give the largest force of the device"
            ),
            torque_limit_Nm,
        )
        self.share = 0.0
        self.events: list[tuple[float, str]] = []
        self.bad_ticks = 0
        self.reach: Reach | None = None
        self._good: Sample | None = None
        self._fault = ""
        self._wrench = (np.zeros(3), np.zeros(3))
        self._clock: float | None = None
        self._step = 0.0
        self._places = Roughness(ROUGHEST_M_S2)
        # The change of a quaternion is half the angle of the rotation.
        self._turns = Roughness(0.5 * ROUGHEST_RAD_S2)
        self._turned: Quaternion = UPRIGHT

    def validate_sample(self, sample: Sample | None, time_s: float) -> Sample | None:
        """Return a valid sample with a normalised quaternion; return None for an invalid sample.

        Raises
        ------
        DeviceError
            If the argument is not a `Sample`, if an entry of the sample has a wrong length, or if
            the device leaves its reach.
        """
        turned = None
        if sample is not None:
            total = _total(sample)
            if total is None:
                sample = _repaired(sample)
                total = sum(map(sum, sample[1:]), sample.time_s)
            turned = unit(sample.quaternion) if isfinite(total) else None
        self._step = 0.0 if self._clock is None else max(time_s - self._clock, 0.0)
        self._clock = time_s
        fault = self._fault_of(sample, turned, time_s)
        if fault != self._fault:
            self._log(time_s, f"{fault}: the force fades" if fault else "samples are good again")
            self._fault = fault
        if fault or sample is None or turned is None:
            self.bad_ticks += 1
            return None
        if self.reach is not None:
            self.reach.require(sample.position_m, samples=1)
        if self._good is None and abs(turned[0]) > 1.0 - HALF_TURN:
            self._log(time_s, W_FIRST)
        self._good = sample._replace(quaternion=turned)
        return self._good

    def limit_force(
        self, force_N: Array | None, torque_Nm: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the force and the torque that must be sent to the device in this tick.

        If the force is None, or if force or torque is not finite, the last force fades in this
        tick.
        """
        change = self._step / FADE_S
        torque = NO_TORQUE if torque_Nm is None else torque_Nm
        if force_N is not None and not isfinite(sum(force_N.tolist()) + sum(torque.tolist())):
            self._log(self._clock or 0.0, "the force is not finite: it fades")
            force_N = None
        if force_N is not None and not self._fault:
            self.share = min(self.share + change, 1.0)
            # Most devices play no torque; the magnitude then is not computed.
            turning = torque if torque is NO_TORQUE else _capped(torque, self._caps[1])
            self._wrench = _capped(force_N, self._caps[0]), turning
        else:
            self.share = max(self.share - change, 0.0)
        return self.share * self._wrench[0], self.share * self._wrench[1]

    def _log(self, time_s: float, what: str) -> None:
        if len(self.events) < MOST_EVENTS:
            self.events.append((time_s, what))
        elif len(self.events) == MOST_EVENTS:
            self.events.append((time_s, "further faults occur and are not listed"))

    def _fault_of(self, sample: Sample | None, turned: Quaternion | None, time_s: float) -> str:
        """Return the fault of a sample as text; empty for a valid sample."""
        good = self._good
        if sample is None:
            return "no sample"
        if turned is None and not isfinite(sum(map(sum, sample[1:]), sample.time_s)):
            return "a sample that is not finite"
        if turned is None or not is_nearly_unit(sample.quaternion):
            return "a quaternion that is not of unit length"
        if time_s - sample.time_s > self._oldest_s:
            return "an old sample"
        if sample.time_s - time_s > self._oldest_s:
            return "a sample time in the future"
        if good is not None and sample.time_s < good.time_s:
            return "a sample time before the last sample"
        x, y, z, w = turned
        if turned != self._turned:
            a, b, c, d = self._turned
            # q and -q are the same orientation: use the sign that is nearer to the last sample.
            if a * x + b * y + c * z + d * w < 0.0:
                x = -x
                y = -y
                z = -z
                w = -w
            self._turned = x, y, z, w
        noisy = self._places.observe(sample.time_s, *sample.position_m)
        if self._turns.observe(sample.time_s, x, y, z, w) or noisy:
            return "noise too large for a hand"
        if max(map(abs, sample.velocity_m_s)) > FASTEST_M_S:
            return f"a speed too high for a hand{UNIT}"
        if max(map(abs, sample.spin_rad_s)) > FASTEST_RAD_S:
            return "a spin too fast for a hand"
        if good is None:
            # The first position has no predecessor. A hand is never 10 m from a device's origin,
            # but the numbers of a position in millimetres often exceed 10.
            is_near = max(map(abs, sample.position_m)) < 10.0
            return "" if is_near else f"a position too far away for a hand{UNIT}"
        elapsed = max(sample.time_s - good.time_s, 0.0) + self._oldest_s
        if dist(sample.position_m, good.position_m) > FASTEST_M_S * elapsed:
            return f"a jump too large for a hand{UNIT}"
        if turned == good.quaternion:
            return ""
        i, j, k = turn_between(good.quaternion, turned)
        if i * i + j * j + k * k > (FASTEST_RAD_S * elapsed) ** 2:
            return "a turn too large for a hand"
        return ""


def _total(sample: Sample) -> float | None:
    """Return the sum of all numbers of a sample, which is finite only if all numbers are finite.

    The result is None if an entry of the sample has a wrong type or a wrong number of entries.
    """
    if not isinstance(sample, Sample):
        raise DeviceError(
            "device.read",
            "return a Sample or None",
            type(sample).__name__,
            "use tissue.Sample(time_s, position_m)",
        )
    try:
        time_s, (x, y, z), (vx, vy, vz), (qx, qy, qz, qw), (wx, wy, wz) = sample
        total = time_s + x + y + z + vx + vy + vz + qx + qy + qz + qw + wx + wy + wz
    except (TypeError, ValueError, OverflowError):
        return None
    kinds = {*map(type, (time_s, x, y, z, vx, vy, vz, qx, qy, qz, qw, wx, wy, wz))}
    return total if isinstance(total, float) and kinds <= PLAIN else None


def _repaired(sample: Sample) -> Sample:
    """Return a copy of a sample with its vectors converted to tuples of floats.

    The vectors may be arrays. Text or bool instead of a number raises an error.
    """
    parts: list[object] = []
    for name, given, shape in zip(Sample._fields, sample, SHAPES, strict=True):
        try:
            numbers = np.asarray(given)
            is_right = numbers.shape == shape and numbers.dtype.kind in "iuf"
            listed = given if isinstance(given, list | tuple) else ()
        except (TypeError, ValueError):
            is_right = False
        if not is_right or any(isinstance(each, bool | np.bool_) for each in listed):
            # The text of an array may be long.
            got = " ".join(repr(given).split())[:60]
            wanted = f"{shape[0]} numbers" if shape else "a number"
            raise DeviceError(
                "device.read",
                f"return a Sample whose {name} is {wanted}",
                got,
                "fix the method read of the device",
            )
        parts.append(tuple(numbers.astype(float).tolist()) if shape else float(numbers))
    return Sample(*parts)  # type: ignore[arg-type]


def _capped(vector: Array, limit: float) -> Array:
    """Return a vector, shortened to the length `limit` if it is longer."""
    size = sqrt(vector.dot(vector))
    return vector * (limit / size) if size > limit else np.array(vector)


ROUNDING = 1e-9
"""Tolerance in the comparison of times [s] and of numbers of ticks."""
OLDEST = 2.5
"""Age above which a sample is treated as missing, divided by the time between two samples.

The value allows for up to two missing samples and half a period of jitter.
"""


class NewSamples:
    """Detector for the ticks in which a device has a new sample.

    If a device has its own clock, a new sample is recognised by its changed time. Any other device
    returns its last pose again, with the time of the present tick. For such a device, a pose counts
    as new if it has changed, or if it was unchanged for the time between two samples.

    Parameters
    ----------
    sample_s
        Time between two samples [s]. If the device has a sample in every tick, each sample is new.
    """

    def __init__(self, sample_s: float) -> None:
        self._ticks = ceil(sample_s / TICK_S - ROUNDING)
        self.pause()

    def pause(self) -> None:
        """Reset after missing samples, so that the next sample counts as new."""
        self._waited = 0
        self._last = Sample(nan, (nan, nan, nan))

    def is_new(self, sample: Sample, time_s: float) -> bool:
        """Return True if the sample of the tick at ``time_s`` is a new sample."""
        if self._ticks <= 1:
            return True
        last = self._last
        self._last = sample
        self._waited += 1
        if sample.time_s == last.time_s:
            return False
        is_dated = abs(sample.time_s - time_s) > ROUNDING
        has_changed = sample.position_m != last.position_m or sample.quaternion != last.quaternion
        if not (is_dated or has_changed or self._waited >= self._ticks):
            return False
        self._waited = 0
        return True


def guard_of(device: Device, limits: DeviceParameters, *, sample_s: float) -> SampleGuard:
    """Return the guard of a device that has a new sample every ``sample_s`` [s]."""
    guard = SampleGuard(
        force_limit_N=limits.force_limit_N,
        torque_limit_Nm=limits.torque_limit_Nm,
        oldest_s=OLDEST * sample_s,
    )
    guard.reach = reach_of(device, limits)
    return guard
