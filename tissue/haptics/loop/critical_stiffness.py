"""Whether a wall is stable on a device, known before it runs: eigenvalues of the sampled loop
with its exact delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import floor, inf, log10, pi

from scipy.optimize import brentq

from meshes.base.errors import InputError
from tissue.haptics.loop.sampled_loop import WallLoop, largest_eigenvalue, spectral_radius

__all__ = [
    "Verdict",
    "critical_stiffness_N_m",
    "in_hands",
    "judge",
    "nearest_stable_N_m",
    "require_stable",
]

SOFTEST_N_M, STIFFEST_N_M = 1e-2, 1e8
"""Range in which the critical stiffness is looked for [N/m]."""
STEPS, NARROW_STEPS = 4, 24
"""In a decade of that search, and where there may be a narrow window: where a loop rings at half of
its vibration's frequency. Over 5-60 Hz and shares to 1 on a touch, the windows that 24 steps miss
grow by less than a part in 5000 a tick, of those that 16 miss some by a part in 700."""
ON_THE_CIRCLE = 1e-12
"""Eigenvalues closer to 1 than this count as settling: rounding, and a wall so soft that nothing
moves.
"""


@dataclass(frozen=True)
class Verdict:
    """What is known of a loop before it runs.

    Attributes
    ----------
    stable
        Whether every mode settles, in every hand that was asked for.
    margin
        Share of the critical stiffness that is left, 1 - K / K_critical: 0 at the boundary,
        negative beyond it.
    critical_N_m
        Stiffness at which the first mode stops settling, in the worst of the hands [N/m].
    nearest_N_m
        The given stiffness if it is stable, else the nearest stable one, rounded down to three
        digits [N/m].
    spectral_radius
        Growth over one tick of the slowest mode, in the worst of the hands.
    """

    stable: bool
    margin: float
    critical_N_m: float
    nearest_N_m: float
    spectral_radius: float

    def sentence(self, stiffness_N_m: float) -> str:
        """The verdict in words."""
        if self.stable:
            return (
                f"stiffness {stiffness_N_m:.4g} N/m is stable, {100.0 * self.margin:.1f} % below "
                "the critical value"
            )
        if self.critical_N_m == 0.0:
            return (
                f"stiffness {stiffness_N_m:g} N/m is unstable and so is every other: lower "
                "damping, delay or filter"
            )
        return (
            f"stiffness {stiffness_N_m:g} N/m is unstable, margin {100.0 * self.margin:.1f} %: "
            f"the nearest stable value is {self.nearest_N_m:g} N/m"
        )


def in_hands(loop: WallLoop, hands: Sequence[tuple[float, float, float]]) -> tuple[WallLoop, ...]:
    """The loop in several hands, each of stiffness [N/m], damping [N s/m] and mass [kg]; no hand
    is (0, 0, 0).
    """
    return tuple(
        replace(loop, hand_stiffness_N_m=stiffness, hand_damping_N_s_m=damping, hand_mass_kg=mass)
        for stiffness, damping, mass in hands
    )


def critical_stiffness_N_m(loop: WallLoop) -> float:
    """Lowest stiffness at which the loop stops settling [N/m]; 0 if the softest wall is unstable,
    inf if none is.

    Looked for upwards, in `STEPS` or `NARROW_STEPS` a decade, then between the last two by Brent's
    method to rounding. What lies above a first unstable stiffness is never called stable, also
    where a window of it might be.
    """
    return _critical_N_m(loop.with_stiffness(SOFTEST_N_M))


@lru_cache(maxsize=64)
def _critical_N_m(loop: WallLoop) -> float:
    """The same, found once for loops that differ in their stiffness alone: a choice is followed
    by its verdict.
    """
    low = 0.0
    high = SOFTEST_N_M
    while _beyond(high, loop) < 0.0:
        low = high
        high = high * 10.0 ** (1.0 / _steps(high, loop))
        if low > STIFFEST_N_M:
            return inf
    return (
        float(brentq(_beyond, low, high, args=(loop,), xtol=1e-10 * low, rtol=1e-10))
        if low > 0.0
        else 0.0
    )


def _steps(stiffness_N_m: float, loop: WallLoop) -> int:
    """Steps in a decade from a stiffness on: narrow ones from where the undamped mass rings at f
    / 4.
    """
    if loop.vibration is None:
        return STEPS
    turn = 0.5 * pi * loop.vibration.frequency_Hz
    mass = loop.mass_kg + loop.hand_mass_kg
    return NARROW_STEPS if stiffness_N_m + loop.hand_stiffness_N_m > mass * turn**2 else STEPS


def nearest_stable_N_m(critical_N_m: float) -> float:
    """A stable stiffness below the critical one, rounded down to three digits [N/m]."""
    if not 0.0 < critical_N_m < inf:
        return critical_N_m
    unit = 10.0 ** (floor(log10(critical_N_m)) - 2)
    return floor((1.0 - 1e-9) * critical_N_m / unit) * unit


def judge(loop: WallLoop, hands: Sequence[tuple[float, float, float]] | None = None) -> Verdict:
    """Judge a loop; with ``hands`` (see `in_hands`) in the worst of them, instead of the loop's
    own.
    """
    loops = (loop,) if hands is None else in_hands(loop, hands)
    critical = min(critical_stiffness_N_m(each) for each in loops)
    stiffness = loop.stiffness_N_m
    stable = stiffness < critical
    margin = 1.0 - stiffness / critical if critical > 0.0 else -inf
    nearest = stiffness if stable else nearest_stable_N_m(critical)
    return Verdict(stable, margin, critical, nearest, max(spectral_radius(each) for each in loops))


def require_stable(
    loop: WallLoop, hands: Sequence[tuple[float, float, float]] | None = None
) -> Verdict:
    """Judge a loop and refuse an unstable one.

    Raises
    ------
    InputError
        If the wall is unstable in one of the hands; the sentence names the margin and the nearest
        stable stiffness.
    """
    verdict = judge(loop, hands)
    if verdict.stable:
        return verdict
    if verdict.critical_N_m == 0.0:
        raise InputError(
            "wall_damping_N_s_m",
            "leave some stiffness stable",
            f"{loop.wall_damping_N_s_m:g}",
            "lower it, or the delay, or the filter",
        )
    raise InputError(
        "stiffness_N_m",
        f"be below {verdict.critical_N_m:.4g} to be stable",
        f"{loop.stiffness_N_m:g} (margin {100.0 * verdict.margin:.1f} %)",
        f"use {verdict.nearest_N_m:g}",
    )


def _beyond(stiffness_N_m: float, loop: WallLoop) -> float:
    """How far the largest eigenvalue lies beyond what counts as settling; below zero no mode
    grows.
    """
    return largest_eigenvalue(loop.with_stiffness(stiffness_N_m)) - (1.0 - ON_THE_CIRCLE)
