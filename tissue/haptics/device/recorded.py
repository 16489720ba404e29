"""Devices without force output: recorded motion, and a mouse in a window."""

from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import exp, nan
from types import TracebackType
from typing import Literal, Self

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.haptics.device.device import ComputedDevice, Device, Sample
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

__all__ = ["Fault", "FaultKind", "FaultyDevice", "MouseDevice", "RecordedDevice"]


class RecordedDevice(ComputedDevice):
    """Device that replays a table of poses and ignores commanded forces.

    Parameters
    ----------
    times_s
        Increasing times [s], shape (n,). Before the first and after the last time there is no
        sample.
    positions_m
        Positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    rate_Hz
        Samples per second. Between the given times, positions are interpolated linearly, and
        orientations on the shortest arc.

    Raises
    ------
    InputError
        If times do not increase, a number is not finite or a quaternion is zero.
    """

    def __init__(
        self,
        times_s: Array,
        positions_m: Array,
        quaternions: Array | None = None,
        *,
        rate_Hz: float = 1000.0,
    ) -> None:
        require_positive("rate_Hz", rate_Hz, "use 1000")
        times = np.array(times_s, dtype=float)
        positions = np.array(positions_m, dtype=float)
        if (
            len(times) < 2
            or positions.shape != (len(times), 3)
            or not np.isfinite([*times, *positions.ravel()]).all()
        ):
            raise InputError(
                "positions_m",
                f"be finite with shape ({len(times)}, 3)",
                positions.shape,
                "fix them",
            )
        if not (np.diff(times) > 0.0).all():
            raise InputError("times_s", "increase", times_s, "sort them")
        turned = (
            np.tile(UPRIGHT, (len(times), 1))
            if quaternions is None
            else np.array(quaternions, float)
        )
        sizes = np.linalg.norm(turned, axis=1)
        if turned.shape != (len(times), 4) or not np.isfinite(sizes).all() or (sizes < 1e-6).any():
            raise InputError(
                "quaternions",
                "be finite and not zero, one for each time",
                "others",
                "use 0, 0, 0, 1",
            )
        self._first = float(times[0])
        self._last = float(times[-1])
        self._rate = rate_Hz
        at = np.minimum(
            times[0] + np.arange(round((times[-1] - times[0]) * rate_Hz) + 1) / rate_Hz, times[-1]
        )
        rotation = Slerp(times, Rotation.from_quat(turned))(at)
        tips = np.column_stack([np.interp(at, times, positions[:, axis]) for axis in range(3)])
        speeds = np.diff(tips, axis=0, prepend=tips[:1]) * rate_Hz
        spins = np.zeros_like(tips)
        spins[1:] = (rotation[1:] * rotation[:-1].inv()).as_rotvec() * rate_Hz
        columns = (column.tolist() for column in (at, tips, speeds, rotation.as_quat(), spins))
        rows = zip(*columns, strict=True)
        self._samples = [
            Sample(t, tuple(p), tuple(v), tuple(q), tuple(w)) for t, p, v, q, w in rows
        ]

    def read(self, time_s: float) -> Sample | None:
        """Return the last recorded sample that is not after a time; None outside the recording."""
        if not self._first - 1e-9 <= time_s <= self._last + 1e-9:
            return None
        return self._samples[
            min(int((time_s - self._first) * self._rate + 1e-6), len(self._samples) - 1)
        ]


class MouseDevice(ComputedDevice):
    """Device driven by positions from a window, smoothed to a continuous motion.

    The window pushes positions at its own rate. Between two pushes, the pose follows the last one
    as a critically damped second-order system. The step is exact for a constant target. Position,
    orientation and their speeds are therefore continuous at any rate of the window.

    Parameters
    ----------
    position_m
        Start position [m].
    response_s
        Time constant of the response to a push [s].
    """

    bounds_itself = True
    """No reach is applied, because the pointer of a mouse is not bounded by an arm."""

    def __init__(self, position_m: Triple = NOTHING, *, response_s: float = 0.03) -> None:
        self._response = require_positive("response_s", response_s, "use 0.03")
        self._target = position_m
        self._turned = UPRIGHT
        self._sample = Sample(0.0, position_m)

    def push(self, position_m: Triple, quaternion: Quaternion = UPRIGHT) -> None:
        """Set the position [m] and orientation of the pointer.

        A window's thread may call it.
        """
        self._target = position_m
        self._turned = quaternion

    def read(self, time_s: float) -> Sample | None:
        """Follow the last push up to a time, and return the sample."""
        last = self._sample
        target = self._target
        turned = self._turned
        step = time_s - last.time_s
        if step <= 0.0:
            return last
        position = []
        velocity = []
        for at, speed, wanted in zip(last.position_m, last.velocity_m_s, target, strict=True):
            away, faster = self._followed(at - wanted, speed, step)
            position.append(wanted + away)
            velocity.append(faster)
        quaternion = last.quaternion
        spins = []
        if turned != quaternion or any(last.spin_rad_s):
            turns = []
            for left, speed in zip(turn_between(quaternion, turned), last.spin_rad_s, strict=True):
                away, faster = self._followed(-left, speed, step)
                turns.append(left + away)
                spins.append(faster)
            quaternion = unit(product(exponential(tuple(turns)), quaternion)) or turned  # type: ignore[arg-type]
        spin = tuple(spins) if spins else (0.0, 0.0, 0.0)
        self._sample = Sample(time_s, tuple(position), tuple(velocity), quaternion, spin)  # type: ignore[arg-type]
        return self._sample

    def _followed(self, away: float, speed: float, step_s: float) -> tuple[float, float]:
        """Return the distance from a target and the speed, one step later."""
        fade = exp(-step_s / self._response)
        rate = 1.0 / self._response
        slope = speed + rate * away
        return fade * (away + slope * step_s), fade * (slope - rate * (away + slope * step_s))


FaultKind = Literal["dropped", "late", "duplicated", "non-finite", "wild"]
WILD_M = 1e9
LATE_READS = 5
"""Delay of a late sample [reads]."""


@dataclass(frozen=True)
class Fault:
    """Fault of the samples between two times [s]."""

    kind: FaultKind
    start_s: float
    end_s: float


class FaultyDevice:
    """Device with faulty samples at given times.

    Samples are dropped, late, repeated, non-finite or wild (1e9 m).
    """

    def __init__(self, device: Device, faults: Sequence[Fault]) -> None:
        self._device = device
        self._faults = tuple(faults)
        self._past: deque[Sample | None] = deque(maxlen=LATE_READS + 1)
        self._returned: Sample | None = None

    @property
    def in_process(self) -> bool:
        """True if the device only computes."""
        return bool(getattr(self._device, "in_process", False))

    def __enter__(self) -> Self:
        if isinstance(self._device, AbstractContextManager):
            self._device.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(self._device, AbstractContextManager):
            self._device.__exit__(kind, error, trace)

    def read(self, time_s: float) -> Sample | None:
        """Return a sample, modified by the fault at this time."""
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
        """Pass the command to the device."""
        self._device.command(force_N, torque_Nm)
