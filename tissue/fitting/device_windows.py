"""Averages of a device's motion and forces with a smooth window, of which no measured derivative is needed.

Positions come in the steps of an encoder, whose second difference is all noise. ``m a + b v + c v / |v| = F`` is
averaged with Gauss' window g instead, and the derivatives are moved onto it by parts::

    m (g'' * x) + b (g' * x) + c (g * v / |v|) = g * F

which is exact for any window (Shinbrot 1957). A step of 55 um at 1 kHz is an error of 0.03 m/s2 of the acceleration in
a window of 10 ms. The second derivative of white noise has correlations of -0.6 between windows that are two standard
deviations apart, 0.0 to 0.1 in size from three on: so far apart they are taken, since noise is fitted as one of first
order. A command is held over a tick, so that its window is wider by the tick, as is its delay by half of it.

The direction of friction is that of the velocity, which a window rounds off where it turns: one of the fourth order
(g less half its second derivative, whose second moment is zero) leaves (w s)^4 / 8 of a tone w instead of
(w s)^2 / 2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["APART_S", "GRID_S", "DeviceAverages", "DeviceLog", "device_averages", "rests"]

WINDOW_S = 0.01
"""Standard deviation of the window [s]: well above an encoder's sample, well below a stroke of a hand."""
GRID_S = 0.004
"""Between averages that are interpolated [s]: a cubic through them is right to 1e-5 at 5 Hz."""
APART_S = 0.03
"""Between averages that are compared, in which noise has next to nothing in common [s]."""
HEADING_S = 0.005
"""Standard deviation of the window of the direction in which friction acts [s]."""
REACH = 6.0
"""Half the window's support over its standard deviation. At 4 the second derivative of a window that is cut off no
longer sums to zero, which took 8 % of the mass at 1.5 Hz."""
RESTS = 2.0
"""Encoder steps that the tip must move in a standard deviation of the window to be in motion."""
REST_SHARE = 1e-3
"""Share of a window that may be at rest, as at a turning point: what it can move the friction by."""
WITHIN = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
"""Places in a tick over which the direction is averaged, which may turn round within one."""
SHORTEST_S = 0.5
"""Shortest log [s]."""


@dataclass(frozen=True, eq=False)
class DeviceLog:
    """A device in motion, at one rate.

    Attributes
    ----------
    times_s
        Shape (n,).
    position_m
        Of the tip as the encoders read it, shape (n, 3).
    applied_N
        Force of the motors on the tip as commanded, shape (n, 3).
    hand_N
        Measured force of what holds it, on the tip, shape (n, 3); None for a free device.
    notes
        What was found in its file, in sentences.
    """

    times_s: Array
    position_m: Array
    applied_N: Array
    hand_N: Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        steps = np.diff(self.times_s)
        if len(steps) == 0 or not np.allclose(steps, steps[0], rtol=0.01, atol=0.0) or steps[0] <= 0.0:
            raise InputError("times_s must rise at one rate, got others: resample the log")
        if self.step_s > 1.01 * WINDOW_S:
            raise InputError(
                f"times_s must rise by {1e3 * WINDOW_S:g} ms or less, got {1e3 * self.step_s:.3g} ms: log the device "
                "faster"
            )
        if len(self.times_s) * steps[0] < SHORTEST_S:
            raise InputError(
                f"the log must last {SHORTEST_S:g} s, got {len(steps) * steps[0]:.3g} s: record the device for several "
                "seconds"
            )

    @property
    def step_s(self) -> float:
        """Between two samples [s]."""
        return float(np.median(np.diff(self.times_s)))

    @property
    def force_N(self) -> Array:
        """All forces on the tip but its friction and inertia, shape (n, 3)."""
        return self.applied_N if self.hand_N is None else self.applied_N + self.hand_N


@dataclass(frozen=True, eq=False)
class DeviceAverages:
    """Averages of a log over windows.

    Attributes
    ----------
    basis, bends
        Of acceleration, velocity and direction, and of their second derivatives by time, shape (n, axes, 3).
    force_N
        Of what is measured: the hand's force on a held device, else the command, shape (n, axes); NaN where the tip
        rests.
    motors_N
        Of the motors' force, shape (n, axes).
    """

    basis: Array
    bends: Array
    force_N: Array
    motors_N: Array


def device_averages(log: DeviceLog, axes: NDArray[np.int64], encoder_step_m: float, every: int) -> DeviceAverages:
    """Averages of a log along some axes at every so many samples."""
    step, at = log.step_s, slice(None, None, every)
    position = log.position_m - log.position_m[0]
    direction = _direction(position, step)
    columns = [_filtered(position, step, 2), _filtered(position, step, 1), _filtered(direction, step, 0)]
    bends = [_filtered(position, step, 4), _filtered(position, step, 3), _filtered(direction, step, 2)]
    rest = _filtered(rests(log, encoder_step_m)[:, None].astype(float), step, 0)[:, 0]
    held_s = float(np.sqrt(WINDOW_S**2 + step**2 / 12.0))
    motors = _filtered(log.applied_N, step, 0, held_s)
    force = motors if log.hand_N is None else _filtered(log.hand_N, step, 0)
    edge = 2 * round(REACH * WINDOW_S / step)
    inside = np.zeros(len(force), dtype=bool)
    inside[edge:-edge] = True
    force = np.where((inside & (rest < REST_SHARE))[:, None], force, np.nan)
    basis, bent = (np.stack(each, axis=-1)[at, axes] for each in (columns, bends))
    return DeviceAverages(basis, bent, force[at, axes], motors[at, axes])


def rests(log: DeviceLog, encoder_step_m: float) -> NDArray[np.bool_]:
    """Where the tip moves less than a few steps of the encoder in the window, shape (n,)."""
    speed = np.linalg.norm(_filtered(log.position_m, log.step_s, 1), axis=1)
    return np.asarray(speed * WINDOW_S < RESTS * encoder_step_m)


def _direction(position_m: Array, step_s: float) -> Array:
    """Direction of the velocity, averaged over each tick, shape (n, 3)."""
    heading = _filtered(position_m, step_s, 1, HEADING_S)
    heading = heading - 0.5 * HEADING_S**2 * _filtered(position_m, step_s, 3, HEADING_S)
    slope = np.gradient(heading, axis=0)
    return np.asarray(np.mean([_unit(heading + share * slope) for share in WITHIN], axis=0))


def _unit(vectors: Array) -> Array:
    """Vectors of length 1, shape (n, 3); zero ones stay."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.where(size > 0.0, vectors / np.maximum(size, 1e-12), 0.0))


def _filtered(values: Array, step_s: float, derivative: int, window_s: float = WINDOW_S) -> Array:
    """Average with Gauss' window, or with one of its derivatives, shape (n, any)."""
    from scipy.ndimage import gaussian_filter1d

    found = gaussian_filter1d(values, window_s / step_s, axis=0, order=derivative, truncate=REACH, mode="nearest")
    return np.asarray(found / step_s**derivative, dtype=np.float64)
