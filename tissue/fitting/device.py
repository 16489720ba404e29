"""Mass, damping and friction of a haptic device from logs of it free and held.

The tip obeys ``m a + b v + c v / |v| = gain applied + hand``. Positions come in the steps of an encoder, whose second
difference is all noise. Both sides are averaged with a smooth window g instead, and the derivatives moved onto it by
parts::

    m (g'' * x) + b (g' * x) + c (g * v / |v|) = g * (gain applied + hand)

which is exact for any window and needs no derivative of what was measured (Shinbrot 1957). With Gauss' window
of 10 ms a step of 55 um at 1 kHz is an error of 0.03 m/s2 of the acceleration: over one of
10 m/s2 it lowers the mass by 1e-5 of it. The equation is linear in the constants. What delays the motors (transport,
amplifier) is the offset of clocks that every fit estimates.

While the tip is at rest, friction is anything up to c: such windows are left out. They bound c from below, see
`least_friction_N`. The motors give a gain times what is commanded, which is estimated with the constants: a log of
motor forces alone determines these in units of the gain; the force sensor of the held log is what makes them newtons.

Of a simulated device that nothing disturbs the mass is 0.03 % too great, from positions and forces that are held over a
tick: narrower intervals are too narrow (`python tests/bench/bench_fit_device.py 12`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.parameter import Parameter
from tissue.materials.constants import constants
from tissue.materials.prior import Prior

__all__ = ["DeviceLog", "device_fit", "least_friction_N"]

WINDOW_S = 0.01
"""Standard deviation of the window [s]: well above an encoder's sample, well below a stroke of a hand."""
HEADING_S = 0.004
"""The same for the direction in which friction acts, which is averaged again [s]."""
REACH = 6.0
"""Half the window's support over its standard deviation. At 4 the second derivative of a window that is cut off no
longer sums to zero, which took 8 % of the mass at 1.5 Hz."""
RESTS = 2.0
"""Encoder steps that the tip must move in a standard deviation of the window to be in motion."""
REST_SHARE = 1e-3
"""Share of a window that may be at rest, as at a turning point: what it can move the friction by."""
AXES = ("x", "y", "z")
GAIN = Parameter("motors.gain", Prior(1.0, 0.85, 1.18))
"""What motors give over what is commanded: 10 % between copies of a device (from memory of the literature)."""


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
        Force of the motors on the tip, shape (n, 3).
    hand_N
        Measured force of what holds it, on the tip, shape (n, 3); None for a free device.
    """

    times_s: Array
    position_m: Array
    applied_N: Array
    hand_N: Array | None = None

    def __post_init__(self) -> None:
        steps = np.diff(self.times_s)
        if len(steps) == 0 or not np.allclose(steps, steps[0], rtol=0.01, atol=0.0) or steps[0] <= 0.0:
            raise InputError("times_s must rise at one rate, got others: resample the log")
        if len(self.times_s) * steps[0] < 4.0 * REACH * WINDOW_S:
            raise InputError(
                f"the log must last {4.0 * REACH * WINDOW_S:g} s, got {len(steps) * steps[0]:.3g} s: record the device "
                "for several seconds"
            )

    @property
    def force_N(self) -> Array:
        """All forces on the tip but its friction and inertia, shape (n, 3)."""
        return self.applied_N if self.hand_N is None else self.applied_N + self.hand_N


@dataclass(frozen=True, eq=False)
class DeviceForward:
    """The averaged equation of a device; a `Forward`.

    Attributes
    ----------
    parameters, channels, times_s
        See `tissue.fitting.forward.Forward`; the last parameter is the gain of the motors.
    basis
        Averages of acceleration, velocity and direction, shape (n, channels, 3).
    applied_N
        Of the motors' force while the device is held, shape (n, channels).
    alone
        Whether the device is free: then its motors' force is what the equation gives, else the hand's, shape (n,).
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    basis: Array
    applied_N: Array
    alone: NDArray[np.bool_]

    def loads(self, x: Array) -> Array:
        """See `Forward`."""
        needed = self.basis @ np.asarray(x[:3], dtype=float)
        return np.where(self.alone[:, None], needed / x[3], needed - x[3] * self.applied_N)

    def jacobian(self, x: Array) -> Array:
        """See `Forward`."""
        needed = self.basis @ np.asarray(x[:3], dtype=float)
        by_gain = np.where(self.alone[:, None], -needed / x[3] ** 2, -self.applied_N)
        by_constants = np.where(self.alone[:, None, None], self.basis / x[3], self.basis)
        return np.concatenate([by_constants, by_gain[:, :, None]], axis=2)


def device_fit(name: str, logs: tuple[DeviceLog, ...]) -> tuple[DeviceForward, MeasuredLoads]:
    """What a fit of a device of `tissue/materials/devices.toml` takes: the averaged equation of one or more logs.

    Raises
    ------
    InputError
        If the device is not listed, or never moves.
    """
    cited = constants("devices", name)
    parameters = tuple(
        Parameter(f"devices.{name}.{each}", Prior.of(cited[each], each))
        for each in ("mass_kg", "damping_N_s_m", "friction_N")
    )
    bases, values, motors, alone = [], [], [], []
    step = float(np.median(np.diff(logs[0].times_s)))
    for log in logs:
        if abs(float(np.median(np.diff(log.times_s))) / step - 1.0) > 0.01:
            raise InputError("logs must have one rate, got several: resample them to the first one's")
        basis, force, applied = _averaged(log, cited["encoder_step_m"].value)
        bases.append(basis)
        values.append(force)
        motors.append(np.zeros_like(applied) if log.hand_N is None else applied)
        alone.append(np.full(len(force), log.hand_N is None))
    measured = np.concatenate(values)
    if not np.isfinite(measured).any():
        raise InputError("the log must show the device in motion, got one at rest: let it move by centimetres")
    every = max(round(WINDOW_S / step), 1)
    times = np.asarray(step * every * np.arange(len(measured)), dtype=np.float64)
    channels = tuple(f"force_{axis}_N" for axis in AXES)
    whole = np.concatenate(bases)
    moves = np.isfinite(measured).any(axis=0) & (np.abs(whole).max(axis=(0, 2)) > 0.0)
    kept = tuple(channel for channel, moved in zip(channels, moves, strict=True) if moved)
    return (
        DeviceForward(
            (*parameters, GAIN), kept, times, whole[:, moves], np.concatenate(motors)[:, moves], np.concatenate(alone)
        ),
        MeasuredLoads(times, measured[:, moves], kept),
    )


def least_friction_N(log: DeviceLog, encoder_step_m: float) -> float:
    """Greatest force that was on the tip while it rested [N]: friction is no less; 0 for a tip that never rests."""
    rests = _rests(log, encoder_step_m)
    return float(np.linalg.norm(log.force_N[rests], axis=1).max()) if rests.any() else 0.0


def _averaged(log: DeviceLog, encoder_step_m: float) -> tuple[Array, Array, Array]:
    """Averages of acceleration, velocity and direction, (k, 3, 3), of what is measured (the hand's force on a held
    device, else that of the motors), (k, 3), NaN where the tip rests, and of the motors' force, (k, 3)."""
    step = float(np.median(np.diff(log.times_s)))
    position = log.position_m - log.position_m[0]
    speed = _filtered(position, step, 1)
    heading = _filtered(position, step, 1, HEADING_S)
    moves = np.linalg.norm(heading, axis=1, keepdims=True)
    direction = np.where(moves > 0.0, heading / np.maximum(moves, 1e-12), 0.0)
    columns = [_filtered(position, step, 2), speed, _filtered(direction, step, 0)]
    rest = _filtered(_rests(log, encoder_step_m)[:, None].astype(float), step, 0)[:, 0]
    force = _filtered(log.applied_N if log.hand_N is None else log.hand_N, step, 0)
    edge = round(REACH * WINDOW_S / step)
    inside = np.zeros(len(force), dtype=bool)
    inside[2 * edge : -2 * edge] = True
    force = np.where((inside & (rest < REST_SHARE))[:, None], force, np.nan)
    every = max(round(WINDOW_S / step), 1)
    motors = _filtered(log.applied_N, step, 0)
    return np.stack(columns, axis=-1)[::every], force[::every], motors[::every]


def _rests(log: DeviceLog, encoder_step_m: float) -> NDArray[np.bool_]:
    """Where the tip moves less than a few steps of the encoder in the window, shape (n,)."""
    speed = np.linalg.norm(_filtered(log.position_m, float(np.median(np.diff(log.times_s))), 1), axis=1)
    return np.asarray(speed * WINDOW_S < RESTS * encoder_step_m)


def _filtered(values: Array, step_s: float, derivative: int, window_s: float = WINDOW_S) -> Array:
    """Average with Gauss' window, or with its first or second derivative, shape (n, any)."""
    from scipy.ndimage import gaussian_filter1d

    found = gaussian_filter1d(values, window_s / step_s, axis=0, order=derivative, truncate=REACH, mode="nearest")
    return np.asarray(found / step_s**derivative, dtype=np.float64)
