"""Stability limit of a virtual wall, from simulation, from eigenvalues and from theory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.critical_stiffness import (
    Verdict,
    critical_stiffness_N_m,
    delay_bound_N_m,
    judge,
    pade_bound_N_m,
    passive_bound_N_m,
)
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.sampled_loop import (
    ForecastMemory,
    SampledVelocity,
    WallLoop,
    plant_step,
    spectral_radius,
)
from tissue.haptics.loop.vibration import ENVELOPE_S

SOFTEST_N_M = 0.1
STIFFEST_N_M = 1e6
"""Largest stiffness in the bisection [N/m]; `SOFTEST_N_M` is the smallest stiffness.

The stability limits of built-in devices are between 400 and 5000 N/m.
"""
BISECTIONS = 15
"""Number of bisections of the seven decades of stiffness, for a resolution of 0.05 %."""


@dataclass(frozen=True)
class StabilityChart:
    """Critical stiffness of a loop as a function of one parameter of the loop.

    Attributes
    ----------
    along
        Field of `WallLoop` that is varied.
    values
        Values of the field, shape (n,).
    measured_N_m, exact_N_m
        Critical stiffness computed by simulation of the loop, and from its eigenvalues, shape (n,).
    lines_N_m
        Theoretical bounds, keyed by the name of the bound, each of shape (n,).
    stiffnesses_N_m
        Wall stiffnesses for which `growth` is computed, shape (k,).
    growth
        Spectral radius, shape (k, n), for each stiffness and each value; the loop is stable below
        1.
    """

    along: str
    values: Array
    measured_N_m: Array
    exact_N_m: Array
    lines_N_m: dict[str, Array]
    stiffnesses_N_m: Array
    growth: Array


@dataclass(frozen=True)
class StabilityMap:
    """Stability charts as functions of damping and delay, and stability of a chosen loop."""

    chosen: WallLoop
    verdict: Verdict
    over_damping: StabilityChart
    over_delay: StabilityChart


def growth_while_running(
    loops: Sequence[WallLoop], stiffnesses_N_m: Array, *, ticks: int = 4000
) -> Array:
    """Return the growth of the oscillation of n simulated loops, shape (n,).

    The n loops are simulated at once, after a push. All loops must have the same ``tick_s``,
    ``model_ticks``, velocity filter, ``forecast`` and ``vibration``. A loop runs as on a device:
    sample, velocity, force, filter, delay, zero-order hold. The growth is the square root of an
    energy ratio: the mean energy around 85 % of the run, divided by the mean energy around 45 %.
    The energy is the sum of kinetic and stored energy. The growth is infinite after an overflow.
    With 4000 ticks, the critical stiffness found with this function differs by at most 0.02 % from
    the critical stiffness computed from eigenvalues (validation case 21).
    """
    first = loops[0]
    tick = first.tick_s
    count = len(loops)
    of = lambda name: np.array([getattr(each, name) for each in loops])  # noqa: E731
    delay = of("delay_s")
    # 1e-9: a delay of whole ticks must not be rounded down to one tick less.
    whole = (delay / tick + 1e-9).astype(int)
    part = np.maximum(delay - whole * tick, 0.0)
    mass = of("mass_kg") + of("hand_mass_kg")
    held = of("hand_stiffness_N_m")
    damped = of("damping_N_s_m") + of("hand_damping_N_s_m")
    steps = []
    for behind, lengths in ((whole + 1, part), (whole, tick - part)):
        # A loop whose delay is a whole number of ticks has an empty first part of the tick. A step
        # of 1e-12 s instead has no effect.
        given = (mass, damped, held, of("amplifier_Hz"), np.maximum(lengths, 1e-12))
        rows = [plant_step(*each) for each in zip(*(each.tolist() for each in given), strict=True)]
        steps.append((np.moveaxis(np.array(rows), 0, -1), behind))
    length = int(whole.max()) + 2
    columns = np.arange(count)
    queue = np.zeros((length, count))
    reflex_ticks = np.array([each.reflex_ticks for each in loops])
    reflex_N_m = of("reflex_N_m")
    memory = int(reflex_ticks.max()) + 1
    felt = np.zeros((memory, count))
    spring = stiffnesses_N_m + held
    damping = of("wall_damping_N_s_m")
    gain = np.array([low_pass_gain(each.filter_s, tick) for each in loops])
    places, ages = (0, 0) if first.forecast is None else first.forecast.memory
    filtering = first.velocity_memory is not None
    nothing = [np.zeros(count)]
    seen = ForecastMemory(first, nothing * places, nothing * (places * filtering), nothing * ages)
    velocity = SampledVelocity(first, np.zeros((3 * filtering, count)))
    plant = np.zeros((5, count))
    # The loop is linear: the size of the push [m/s] does not matter.
    plant[1] = 1e-3
    before, force, filtered, envelope = np.zeros((4, count))
    follows = low_pass_gain(ENVELOPE_S, tick)
    share = np.arange(ticks) / ticks
    # The windows are smooth, so that the phase of the oscillation at their ends has no effect. The
    # first window begins after the transients of the push.
    windows = [
        np.where(abs(share - at) < 0.15, np.cos((share - at) * np.pi / 0.3) ** 2, 0.0)
        for at in (0.45, 0.85)
    ]
    sums = np.zeros((2, count))
    with np.errstate(over="ignore", invalid="ignore"):
        for n in range(ticks):
            speed = velocity.step(plant[0])
            place = velocity.state[0] if first.observes else plant[0].copy()
            phase = n % first.model_ticks
            if phase == 0:
                moved = (plant[0] - before) / (tick * first.model_ticks)
                force = -stiffnesses_N_m * place - damping * (moved if speed is None else speed)
                before = plant[0].copy()
            predicted = seen.predict(plant[0].copy(), speed, force, phase)
            filtered = filtered + gain * (predicted - filtered)
            envelope = envelope + follows * (filtered - envelope)
            shaken = first.vibration.factor(n) if first.vibration else 0.0
            queue[n % length] = filtered + shaken * envelope
            felt[n % memory] = plant[0]
            plant[4] = -reflex_N_m * felt[(n - reflex_ticks) % memory, columns]
            for matrix, behind in steps:
                plant[3] = queue[(n - behind) % length, columns]
                plant[:3] = np.einsum("ijn,jn->in", matrix, plant)
            energy = mass * plant[1] ** 2 + spring * plant[0] ** 2
            sums[0] += windows[0][n] * energy
            sums[1] += windows[1][n] * energy
        growth = np.sqrt(sums[1] / sums[0])
    return np.where(np.isfinite(growth), growth, inf)


def measured_critical_N_m(loops: Sequence[WallLoop], *, ticks: int = 4000) -> Array:
    """Return the stiffness [N/m], shape (n,), above which the oscillation of each loop grows.

    The stiffness is computed by bisection for all loops at once. The result is zero if the
    oscillation grows even with the softest wall (0.1 N/m).
    """
    low = np.full(len(loops), SOFTEST_N_M)
    high = np.full(len(loops), STIFFEST_N_M)
    hopeless = growth_while_running(loops, low, ticks=ticks) >= 1.0
    for _ in range(BISECTIONS):
        middle = np.sqrt(low * high)
        grows = growth_while_running(loops, middle, ticks=ticks) >= 1.0
        low = np.where(grows, low, middle)
        high = np.where(grows, middle, high)
    return np.where(hopeless, 0.0, np.sqrt(low * high))


def stability_map(chosen: WallLoop, *, rows: int = 60, columns: int = 25) -> StabilityMap:
    """Compute stability charts as functions of wall damping and delay, around a chosen loop.

    The damping ranges from zero to the value at which a damper stops the mass within the delay plus
    one step. This value is far above the damping with the largest critical stiffness. The delay
    ranges from zero to eight ticks. The stiffness range depends on the critical stiffnesses and the
    chosen stiffness. It is from 1/20 of the smallest to three times the largest of these values.
    """
    step_s = chosen.tick_s * chosen.model_ticks + chosen.delay_s
    most = (chosen.mass_kg + chosen.hand_mass_kg) / step_s
    charts = []
    for along, highest in (("wall_damping_N_s_m", most), ("delay_s", 8.0 * chosen.tick_s)):
        values = np.linspace(0.0, highest, columns)
        loops = [replace(chosen, **{along: value}) for value in values.tolist()]
        exact = np.array([critical_stiffness_N_m(each) for each in loops])
        # A chart needs a range even if no stiffness is stable and the chosen stiffness is 0.
        found = np.append(exact[(exact > 0.0) & (exact < inf)], chosen.stiffness_N_m or 100.0)
        stiffnesses = np.geomspace(0.05 * found.min(), 3.0 * found.max(), rows)
        lines = {
            "passive": np.array([passive_bound_N_m(each) for each in loops]),
            "first order in delay": np.array([delay_bound_N_m(each) for each in loops]),
            "Pade": np.array([pade_bound_N_m(each) for each in loops]),
        }
        growth = [
            [spectral_radius(each.with_stiffness(stiffness)) for each in loops]
            for stiffness in stiffnesses.tolist()
        ]
        measured = measured_critical_N_m(loops)
        charts.append(
            StabilityChart(along, values, measured, exact, lines, stiffnesses, np.array(growth))
        )
    return StabilityMap(chosen, judge(chosen), *charts)
