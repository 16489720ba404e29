"""Devices without force output: recorded motion, and a mouse in a window."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from meshes.base.arrays import Array
from tissue.haptics.device.device import ComputedDevice, Device, Sample
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import (
    NOTHING,
    UPRIGHT,
    Quaternion,
    Triple,
    exponential,
    product,
    turn_between,
    unit,
)


class RecordedDevice(ComputedDevice):
    """Device that plays back a table of poses at 1 kHz, and ignores commanded forces.

    Between the given times, positions are interpolated linearly. Orientations are interpolated
    along the shortest rotation.

    Parameters
    ----------
    times_s
        Increasing times [s], shape (n,). The device has no sample before the first time and after
        the last time.
    positions_m
        Positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    """

    def __init__(
        self, times_s: Array, positions_m: Array, quaternions: Array | None = None
    ) -> None:
        turned = np.tile(UPRIGHT, (len(times_s), 1)) if quaternions is None else quaternions
        self._first = float(times_s[0])
        self._last = float(times_s[-1])
        rate_Hz = 1.0 / TICK_S
        count = round((self._last - self._first) * rate_Hz) + 1
        at = np.minimum(times_s[0] + np.arange(count) / rate_Hz, self._last)
        rotation = Slerp(times_s, Rotation.from_quat(turned))(at)
        tips = np.column_stack([np.interp(at, times_s, positions_m[:, axis]) for axis in range(3)])
        speeds = np.diff(tips, axis=0, prepend=tips[:1]) * rate_Hz
        spins = np.zeros_like(tips)
        spins[1:] = (rotation[1:] * rotation[:-1].inv()).as_rotvec() * rate_Hz
        columns = (column.tolist() for column in (at, tips, speeds, rotation.as_quat(), spins))
        self._samples = [
            Sample(time_s, *map(tuple, rest)) for time_s, *rest in zip(*columns, strict=True)
        ]

    def read(self, time_s: float) -> Sample | None:
        """Return the sample of the last tick at or before a time; None outside the recording."""
        # 1e-9 s allows for rounding of the first and the last time.
        if not self._first - 1e-9 <= time_s <= self._last + 1e-9:
            return None
        # 1e-6 of a tick: the time of a whole tick may be rounded down.
        tick = int((time_s - self._first) / TICK_S + 1e-6)
        return self._samples[min(tick, len(self._samples) - 1)]


RESPONSE_S = 0.03
"""Time constant with which the pose of a `MouseDevice` follows the pointer [s].

The value is about the time between two pictures of a window (1/30 s). With a shorter time constant,
each new pointer position would be visible as a jerk.
"""


class MouseDevice(ComputedDevice):
    """Device driven by positions from a window, smoothed to a continuous motion.

    The window sends pointer positions at its own rate. Until the next pointer position, the pose
    follows the last pointer position as a critically damped second-order system. The motion is
    computed exactly for a constant target. Position, orientation and velocities are therefore
    continuous at any rate of the window.

    Parameters
    ----------
    position_m
        Start position [m].
    """

    bounds_itself = True
    """True: the reach of the device is not checked, because a mouse pointer has no arm."""

    def __init__(self, position_m: Triple = NOTHING) -> None:
        self._target = position_m
        self._turned = UPRIGHT
        self._sample = Sample(0.0, position_m)

    def push(self, position_m: Triple, quaternion: Quaternion = UPRIGHT) -> None:
        """Set the position [m] and orientation of the pointer.

        This method may be called from the thread of a window.
        """
        self._target = position_m
        self._turned = quaternion

    def read(self, time_s: float) -> Sample | None:
        """Move the pose towards the pointer up to ``time_s``, and return the new sample."""
        last = self._sample
        target = self._target
        turned = self._turned
        step = time_s - last.time_s
        if step <= 0.0:
            return last
        offset = [wanted - at for wanted, at in zip(target, last.position_m, strict=True)]
        moved, velocity = _followed(offset, last.velocity_m_s, step)
        x, y, z = (at + more for at, more in zip(last.position_m, moved, strict=True))
        quaternion = last.quaternion
        spin = NOTHING
        # If the pointer does not turn, no quaternions are computed.
        if turned != quaternion or any(last.spin_rad_s):
            turn, spin = _followed(turn_between(quaternion, turned), last.spin_rad_s, step)
            quaternion = unit(product(exponential(turn), quaternion)) or turned
        self._sample = Sample(time_s, (x, y, z), velocity, quaternion, spin)
        return self._sample


def _followed(offset: Sequence[float], speed: Triple, step_s: float) -> tuple[Triple, Triple]:
    """Return the displacement in a step towards ``offset``, and the velocity after the step."""
    fade = exp(-step_s / RESPONSE_S)
    rate = 1.0 / RESPONSE_S
    slope = [v - rate * away for away, v in zip(offset, speed, strict=True)]
    left = [fade * (s * step_s - away) for away, s in zip(offset, slope, strict=True)]
    x, y, z = (away + rest for away, rest in zip(offset, left, strict=True))
    u, v, w = (fade * s - rate * rest for s, rest in zip(slope, left, strict=True))
    return (x, y, z), (u, v, w)


FaultKind = Literal["dropped", "late", "duplicated", "jump"]
LATE_READS = 5
"""Delay of a faulty sample of kind ``late``, in reads.

The delay is twice the age at which `SampleGuard` rejects a sample.
"""


@dataclass(frozen=True)
class Fault:
    """Fault of a device's samples: its kind, and the times [s] at which it begins and ends.

    During a fault of kind ``jump``, the position is ``jump_m`` [m] too low. The jump may be NaN.
    """

    kind: FaultKind
    start_s: float
    end_s: float
    jump_m: float = 0.0


class FaultyDevice(ComputedDevice):
    """Wrapper, for tests, that makes the samples of a device faulty for a limited time.

    During the fault, samples are dropped, late, repeated, or have a wrong position.
    """

    def __init__(self, device: Device, fault: Fault) -> None:
        self._device = device
        self._fault = fault
        self._past: deque[Sample | None] = deque(maxlen=LATE_READS + 1)
        self._returned: Sample | None = None

    def read(self, time_s: float) -> Sample | None:
        """Return the sample of the wrapped device, changed by the fault at this time."""
        sample = self._device.read(time_s)
        fault = self._fault
        self._past.append(sample)
        if not fault.start_s <= time_s < fault.end_s:
            self._returned = sample
            return sample
        if sample is None or fault.kind == "dropped":
            return None
        if fault.kind == "duplicated":
            return self._returned
        if fault.kind == "late":
            return self._past[0]
        x, y, z = sample.position_m
        return sample._replace(position_m=(x, y, z - fault.jump_m))

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Pass the command to the wrapped device."""
        self._device.command(force_N, torque_Nm)
