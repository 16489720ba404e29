"""Devices without force output: recorded motion, and a mouse in a window."""

from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from math import exp, nan
from typing import Literal, Self

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
    """True, so the reach of the device is not checked; a mouse pointer has no arm."""

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


FaultKind = Literal["dropped", "late", "duplicated", "non-finite", "wild"]
WILD_M = 1e9
"""Position of a faulty sample of kind ``wild`` [m]: finite, but beyond any device's reach."""
LATE_READS = 5
"""Delay of a faulty sample of kind ``late``, in reads.

The delay is twice the age at which `SampleGuard` rejects a sample.
"""


@dataclass(frozen=True)
class Fault:
    """Fault of a device's samples: its kind, and the times [s] at which it begins and ends."""

    kind: FaultKind
    start_s: float
    end_s: float


class FaultyDevice:
    """Wrapper of a device that makes its samples faulty at given times, for tests.

    During a fault, samples are dropped, late, repeated, non-finite or wild (position of 1e9 m).
    """

    def __init__(self, device: Device, faults: Sequence[Fault]) -> None:
        self._device = device
        self._faults = tuple(faults)
        self._stack = ExitStack()
        self._past: deque[Sample | None] = deque(maxlen=LATE_READS + 1)
        self._returned: Sample | None = None

    @property
    def in_process(self) -> bool:
        """True if the wrapped device only computes, so that its methods cannot block."""
        return bool(getattr(self._device, "in_process", False))

    def __enter__(self) -> Self:
        if isinstance(self._device, AbstractContextManager):
            self._stack.enter_context(self._device)
        return self

    def __exit__(self, *raised: object) -> None:
        self._stack.close()

    def read(self, time_s: float) -> Sample | None:
        """Return the sample of the wrapped device, changed by the fault at this time."""
        sample = self._device.read(time_s)
        self._past.append(sample)
        kind = next(
            (fault.kind for fault in self._faults if fault.start_s <= time_s < fault.end_s), None
        )
        if kind == "dropped":
            return None
        if kind == "duplicated":
            return self._returned
        if kind == "late":
            return self._past[0]
        if sample is not None and kind is not None:
            wrong = nan if kind == "non-finite" else WILD_M
            sample = sample._replace(position_m=(wrong, *sample.position_m[1:]))
        self._returned = sample
        return sample

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Pass the command to the wrapped device."""
        self._device.command(force_N, torque_Nm)
