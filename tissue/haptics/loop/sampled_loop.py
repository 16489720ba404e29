"""Loop of a haptic device and a virtual wall, as a linear map over one step of the model."""

from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from itertools import pairwise
from math import exp, inf, pi

import numpy as np
from scipy.linalg import expm

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from meshes.base.hints import suggests_arguments
from tissue.haptics.loop.filters import (
    OBSERVER_MEMORY,
    constant_acceleration_map,
    low_pass_gain,
)
from tissue.haptics.loop.forecast import Forecast
from tissue.haptics.loop.vibration import ENVELOPE_S, Vibration
from tissue.models.tissue_model import TICK_S
from tissue.system.blas_threads import one_blas_thread

MOST_TICKS = 400
"""Longest delay and longest model step in the stability analysis [ticks].

The map has one state per tick of delay.
"""


@suggests_arguments
@dataclass(frozen=True, kw_only=True)
class WallLoop:
    """Sampled loop of a device with one degree of freedom and a virtual wall.

    For a rotation, the units are kg m2, N m s/rad and N m/rad.

    Attributes
    ----------
    mass_kg, damping_N_s_m
        Apparent mass [kg] and viscous friction [N s/m] of the device.
    stiffness_N_m, wall_damping_N_s_m
        Stiffness [N/m] and damping [N s/m] of the wall, F = -K x - B v.
    velocity_memory
        Memory of the filter for v, see `constant_acceleration_map`. With None, v is the mean
        velocity over the last model step, and a forecast uses the mean velocity over the last tick.
    observes
        True if x is the position that the filter for v estimates. Requires `velocity_memory`.
    tick_s
        Time between two forces at the device [s]. For a slow device, this is the time between two
        samples.
    delay_s
        Delay [s] from the sample to the force, in addition to the zero-order hold. The delay need
        not be a whole number of ticks.
    model_ticks
        Number of ticks for which one force of the tissue model is held, such as 10 for a model at
        100 Hz in a loop at 1 kHz.
    filter_s
        Time constant of the low-pass after the model [s]; 0 for no filter.
    amplifier_Hz
        Bandwidth of the amplifier [Hz]; infinite for no lag.
    hand_stiffness_N_m, hand_damping_N_s_m, hand_mass_kg
        Stiffness, damping and mass of the linear hand that holds the device [N/m], [N s/m], [kg];
        zeros for a hand that has let go.
    reflex_N_m, reflex_s
        Stiffness of the hand's reflex [N/m], and its delay [s], rounded to whole ticks. The reflex
        force is minus the stiffness times the position one delay earlier.
    forecast
        Linear predictor of the force before the low-pass; None for no predictor. It must have
        ``model_ticks`` phases.
    vibration
        Vibration of a cutter's teeth; None for no vibration. The vibration is added after the
        low-pass. Its amplitude is proportional to the averaged force.
    """

    mass_kg: float
    damping_N_s_m: float
    stiffness_N_m: float
    wall_damping_N_s_m: float = 0.0
    velocity_memory: float | None = None
    observes: bool = False
    tick_s: float = TICK_S
    delay_s: float = 0.0
    model_ticks: int = 1
    filter_s: float = 0.0
    amplifier_Hz: float = inf
    hand_stiffness_N_m: float = 0.0
    hand_damping_N_s_m: float = 0.0
    hand_mass_kg: float = 0.0
    reflex_N_m: float = 0.0
    reflex_s: float = 0.0
    forecast: Forecast | None = None
    vibration: Vibration | None = None

    def __post_init__(self) -> None:
        require_positive("mass_kg", self.mass_kg, "give the device's apparent mass, such as 0.045")
        require_positive("tick_s", self.tick_s, "use 1e-3 for 1 kHz")
        longest_s = MOST_TICKS * self.tick_s
        # The bounds reject values in a wrong unit, and keep the matrix exponential finite.
        hand = "hand_stiffness_N_m", "hand_damping_N_s_m", "hand_mass_kg", "reflex_N_m"
        for names, low, high in (
            (("damping_N_s_m", "stiffness_N_m", *hand), 0.0, 1e9),
            (("wall_damping_N_s_m",), -1e9, 1e9),
            (("model_ticks",), 1, MOST_TICKS),
            (("delay_s", "reflex_s"), 0.0, longest_s),
            (("amplifier_Hz",), 1e-9, inf),
        ):
            for name in names:
                require_range(name, getattr(self, name), low, high, "see `WallLoop`")
        low_pass_gain(self.filter_s, self.tick_s)
        if self.observes and self.velocity_memory is None:
            raise InputError(
                "velocity_memory",
                "be given to a loop that observes the position",
                "none",
                f"use {OBSERVER_MEMORY:g}",
            )

    @property
    def reflex_ticks(self) -> int:
        """Delay of the hand's reflex [ticks]."""
        return round(self.reflex_s / self.tick_s)

    @property
    def vibration_factors(self) -> Array:
        """Vibration divided by the averaged force in n model steps, shape (model_ticks, n)."""
        return (
            np.zeros((self.model_ticks, 1))
            if self.vibration is None
            else self.vibration.period(self.model_ticks)
        )

    def with_stiffness(self, stiffness_N_m: float) -> "WallLoop":
        """Return the loop with another wall stiffness."""
        return replace(self, stiffness_N_m=stiffness_N_m)


@lru_cache(maxsize=4096)  # a stability map uses 14 entries
def plant_step(
    mass_kg: float, damping_N_s_m: float, stiffness_N_m: float, amplifier_Hz: float, step_s: float
) -> tuple[tuple[float, ...], ...]:
    """Return the matrix of an exact time step of a mass, spring and damper with an amplifier.

    The inputs are constant during the step. The matrix, shape (3, 5), is returned as tuples. Its
    rows belong to position, velocity and motor force after the step. Its columns belong to
    position, velocity, motor force, commanded force and external force before the step. For an
    amplifier without lag, the motor force is the commanded force.
    """
    generator = np.zeros((5, 5))
    generator[0, 1] = 1.0
    lag = amplifier_Hz < inf
    generator[1] = np.array([-stiffness_N_m, -damping_N_s_m, lag, not lag, 1.0]) / mass_kg
    if lag:
        generator[2, 2] = -2.0 * pi * amplifier_Hz
        generator[2, 3] = 2.0 * pi * amplifier_Hz
    step = expm(generator * step_s)[:3]
    if not lag:
        step[2] = (0.0, 0.0, 0.0, 1.0, 0.0)
    return tuple(tuple(map(float, row)) for row in step)


def parts_of_tick(delay_s: float, tick_s: float) -> list[tuple[float, int]]:
    """Return the parts of a tick in which the delayed force is constant.

    Each part is a pair: its length [s] and the age of the force in this part [ticks].
    """
    # 1e-9 is for delays that are a whole number of ticks apart from rounding.
    whole = int(delay_s / tick_s + 1e-9)
    delay = delay_s - whole * tick_s
    if delay > 1e-9 * tick_s:
        return [(delay, whole + 1), (tick_s - delay, whole)]
    return [(tick_s, whole)]


def loop_matrix(loop: WallLoop) -> Array:
    """Return the square matrix that maps the loop's state to its state one model step later.

    With a vibration, the later state is one period of the vibration later. The state contains
    position, velocity and motor force, the position at the last model step, the filtered force, the
    pending forces and the velocity filter. With a forecast, it also contains the observed
    positions, velocities and forces. With a vibration, the state contains the envelope of the
    force, and with a reflex the positions during the reflex delay. The columns of the matrix are
    the responses of the loop to unit states, computed tick by tick. The matrix over a period is the
    product of the matrices of its model steps. The eigenvalues determine the stability (Floquet).
    """
    parts = parts_of_tick(loop.delay_s, loop.tick_s)
    spring = loop.hand_stiffness_N_m
    mass = loop.mass_kg + loop.hand_mass_kg
    damping = loop.damping_N_s_m + loop.hand_damping_N_s_m
    steps = [
        (np.array(plant_step(mass, damping, spring, loop.amplifier_Hz, s)), back)
        for s, back in parts
    ]
    queued = parts[0][1]
    places, ages = (0, 0) if loop.forecast is None else loop.forecast.memory
    estimated, speeds = (0, 0) if loop.velocity_memory is None else (3, places)
    shaken = loop.vibration is not None
    has_reflex = loop.reflex_N_m > 0.0
    felt_ticks = loop.reflex_ticks if has_reflex else 0
    # 5: position, velocity, motor force, position at the last model step, filtered force.
    ends = np.cumsum([5, shaken, queued, felt_ticks, estimated, places, speeds, ages]).tolist()
    size = ends[-1]
    factors = loop.vibration_factors
    state = np.tile(np.eye(size), factors.shape[1])
    plant = state[:3]
    before = state[3]
    filtered = state[4]
    envelope, waiting, felt, estimate, *known = (
        state[first:last] for first, last in pairwise(ends)
    )
    queue = list(waiting)
    reflex = list(felt)
    velocity = SampledVelocity(loop, estimate)
    seen = ForecastMemory(loop, *map(list, known))
    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    follows = low_pass_gain(ENVELOPE_S, loop.tick_s)
    model = np.zeros(state.shape[1])
    for tick in range(loop.model_ticks):
        speed = velocity.step(plant[0])
        place = velocity.state[0] if loop.observes else plant[0]
        if tick == 0:
            moved = (plant[0] - before) / (loop.tick_s * loop.model_ticks)
            model = -loop.stiffness_N_m * place - loop.wall_damping_N_s_m * (
                moved if speed is None else speed
            )
            before = plant[0]
        filtered = filtered + gain * (seen.predict(plant[0], speed, model, tick) - filtered)
        envelope = envelope + follows * (filtered - envelope)
        queue.append(filtered + np.repeat(factors[tick], size) * envelope.sum(axis=0))
        reflex.append(plant[0])
        push = -loop.reflex_N_m * reflex.pop(0)
        for matrix, back in steps:
            plant = matrix[:, :4] @ np.vstack([plant, queue[-1 - back]])
            if has_reflex:
                plant += np.outer(matrix[:, 4], push)
        queue.pop(0)
    seen_rows = (*seen.positions, *seen.speeds, *seen.forces)
    kept = (*envelope, *queue, *reflex, *velocity.state, *seen_rows)
    rows = np.vstack([plant, before, filtered, *kept])
    maps = rows.reshape(size, -1, size).swapaxes(0, 1)
    return np.asarray(reduce(lambda first, then: then @ first, maps))


class SampledVelocity:
    """Velocity filter of a loop, applied to several positions at once.

    Parameters
    ----------
    loop
        Loop with or without a filter.
    state
        State of the filter, shape (3, n), or (0, n) without a filter.
    """

    def __init__(self, loop: WallLoop, state: Array) -> None:
        self._rate = 1.0 / loop.tick_s
        self.state = state
        self._filter = (
            None
            if loop.velocity_memory is None
            else constant_acceleration_map(loop.velocity_memory)
        )

    def step(self, position: Array) -> Array | None:
        """Update with the positions in a tick, and return the velocities, shape (n,).

        The result is None for a loop without a filter.
        """
        if self._filter is None:
            return None
        onward, gains = self._filter
        self.state = onward @ self.state + np.outer(gains, position)
        return self._rate * self.state[1]


class ForecastMemory:
    """Previous observations for the forecast of a loop, one entry per tick, newest first.

    Parameters
    ----------
    loop
        Loop with or without a forecast.
    positions, speeds, forces
        Previous positions [m], speeds [m/s] and forces [N], up to the memory of the forecast.
        Speeds are stored only for a loop with a velocity filter.
    """

    def __init__(
        self, loop: WallLoop, positions: list[Array], speeds: list[Array], forces: list[Array]
    ) -> None:
        self._loop = loop
        self.positions = positions
        self.speeds = speeds
        self.forces = forces

    def predict(self, position: Array, speed: Array | None, model: Array, tick: int) -> Array:
        """Return the force at the device in tick number ``tick`` of a model step.

        The force is computed from the position, the filtered speed and the model force.
        """
        forecast = self._loop.forecast
        if forecast is None:
            return model
        rate = 1.0 / self._loop.tick_s
        count = self._loop.model_ticks
        positions = [position, *self.positions]
        forces = [model, *self.forces]
        places, ages = forecast.memory
        speeds = [*([] if speed is None else [speed]), *self.speeds]
        predicted = 0.0 * model
        shown = forecast.stiffness_N_m
        # See `Forecast.stiffness_N_m`: these responses are proportional to the stiffness.
        stiffer = 1.0 if shown is None else self._loop.stiffness_N_m / shown
        for age in range(ages):
            phase = (tick - age) % count
            by_place, by_speed, by_force = forecast.taps[phase, age]
            if places:
                moving = speeds[age] if speeds else rate * (positions[age] - positions[age + 1])
                predicted = predicted + stiffer * (by_place * positions[age] + by_speed * moving)
            if phase == 0:
                predicted = predicted + by_force * forces[age]
        self.positions = positions[:-1]
        self.speeds = speeds[:-1]
        self.forces = forces[:-1]
        return model + forecast.gain * (predicted - model)


def growth_per_model_step(loop: WallLoop) -> float:
    """Return the growth factor per model step of the mode that decays most slowly.

    The factor is the magnitude of the largest eigenvalue of `loop_matrix`. If this matrix maps over
    n model steps, the n-th root of the magnitude is returned. The computation uses only one thread.
    For so few states, two threads are not faster. On a busy computer, two threads even take ten
    times as long, because they wait for each other.
    """
    with one_blas_thread():
        largest = float(np.abs(np.linalg.eigvals(loop_matrix(loop))).max())
    return float(largest ** (1.0 / loop.vibration_factors.shape[1]))


def spectral_radius(loop: WallLoop) -> float:
    """Return the growth factor per tick of the mode that decays most slowly.

    The loop is stable if this factor is below 1, and unstable if it is above 1.
    """
    return float(growth_per_model_step(loop) ** (1.0 / loop.model_ticks))


def motor_lag_ticks(loop: WallLoop) -> float:
    """Return the delay [ticks] of a linearly increasing force on its path to the motor.

    The delay is a sum of four parts. The low-pass y += (1 - p) (u - y) adds p / (1 - p) ticks, and
    the zero-order hold half a tick. The amplifier with bandwidth f adds 1 / (2 pi f) seconds. The
    last part is the delay of the loop.
    """
    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    return (1.0 - gain) / gain + loop.delay_s / loop.tick_s + 0.5 + _amplifier_ticks(loop)


def motor_force_N(loop: WallLoop, force_N: Array) -> Array:
    """Return the mean force of the motor over every tick [N], shape (n, 3).

    The mean force is the impulse of the motor in a tick, divided by the duration of the tick. The
    delay need not be a whole number of ticks. Each force is filtered, held for a tick after its
    delay, and passed through the amplifier.

    Parameters
    ----------
    loop
        Loop with tick, low-pass, delay and amplifier.
    force_N
        One force per tick before the low-pass [N], shape (n, 3). Before the first tick, the force
        is zero.
    """
    from scipy.signal import lfilter

    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    delay = loop.delay_s / loop.tick_s
    # 1e-9: a delay of whole ticks must not be rounded down to one tick less.
    whole = int(delay + 1e-9)
    part = max(delay - whole, 0.0)
    filtered = lfilter([gain], [1.0, gain - 1.0], force_N, axis=0)
    older = _held_back(filtered, whole + 1)
    newer = _held_back(filtered, whole)
    amplifier = _amplifier_ticks(loop)
    if amplifier == 0.0:
        return part * older + (1.0 - part) * newer
    # From the force m, the motor force is u + (m - u) exp(-s / a) after s ticks under the command
    # u. In a tick, the older command acts first, then the newer command.
    first = exp(-part / amplifier)
    second = exp(-(1.0 - part) / amplifier)
    driven = second * (1.0 - first) * older + (1.0 - second) * newer
    starts = _held_back(lfilter([1.0], [1.0, -first * second], driven, axis=0), 1)
    between = older + first * (starts - older)
    lagging = (1.0 - first) * (starts - older) + (1.0 - second) * (between - newer)
    return np.asarray(part * older + (1.0 - part) * newer + amplifier * lagging)


def mean_over_ticks_N(force_N: Array) -> Array:
    """Return the mean force between successive ticks, shape (n - 1, 3), in newtons.

    ``force_N`` is the force at n ticks, shape (n, 3). Between the ticks, the force is interpolated
    linearly.
    """
    return 0.5 * (force_N[:-1] + force_N[1:])


def force_later_N(force_N: Array, ticks: float) -> Array:
    """For each of n ticks, return the force [N], shape (n, 3), that acts some ticks later.

    The number of ticks is the argument `ticks`. Forces between ticks are interpolated linearly.
    After the end of `force_N`, the last force is used.
    """
    at = np.arange(len(force_N))
    return np.column_stack([np.interp(at + ticks, at, axis) for axis in force_N.T])


def _amplifier_ticks(loop: WallLoop) -> float:
    """Return the time constant of the amplifier [ticks]."""
    return 0.0 if loop.amplifier_Hz == inf else 1.0 / (2.0 * pi * loop.amplifier_Hz * loop.tick_s)


def _held_back(force_N: Array, ticks: int) -> Array:
    """Return the force [N] with a delay of ``ticks``; forces before the start are zero."""
    return np.concatenate(
        [np.zeros((min(ticks, len(force_N)), 3)), force_N[: max(len(force_N) - ticks, 0)]]
    )
