"""Stability of a wall on a device before it runs, from eigenvalues of the sampled loop.

The delay is exact.
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
"""Search range of the critical stiffness [N/m]."""
STEPS, NARROW_STEPS = 4, 24
"""Search steps per decade, and smaller steps where a narrow window of instability may exist.

A window may exist where the loop rings at half the frequency of its vibration. Over 5-60 Hz and
shares up to 1 on a touch device, the windows missed by 24 steps grow by less than a part in 5000
per tick. Some windows missed by 16 steps grow by a part in 700.
"""
ON_THE_CIRCLE = 1e-12
"""Distance to 1 below which eigenvalues count as stable.

It covers rounding, and a wall so soft that nothing moves.
"""


@dataclass(frozen=True)
class Verdict:
    """Stability of a loop before it runs.

    Attributes
    ----------
    stable
        True if every mode decays, in every given hand.
    margin
        Stability margin 1 - K / K_critical: 0 at the boundary, negative beyond it.
    critical_N_m
        Stiffness at which the first mode stops decaying, in the worst hand [N/m].
    nearest_N_m
        The given stiffness if it is stable, otherwise the nearest stable stiffness, rounded down to
        three digits [N/m].
    spectral_radius
        Growth of the slowest mode over one tick, in the worst hand.
    """

    stable: bool
    margin: float
    critical_N_m: float
    nearest_N_m: float
    spectral_radius: float

    def sentence(self, stiffness_N_m: float) -> str:
        """Return the verdict as a sentence."""
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
    """Return the loop in several hands, each with stiffness [N/m], damping [N s/m] and mass [kg].

    No hand is (0, 0, 0).
    """
    return tuple(
        replace(loop, hand_stiffness_N_m=stiffness, hand_damping_N_s_m=damping, hand_mass_kg=mass)
        for stiffness, damping, mass in hands
    )


def critical_stiffness_N_m(loop: WallLoop) -> float:
    """Return the lowest stiffness at which the loop is unstable [N/m].

    It is 0 if the softest wall is unstable, and inf if no wall is. The search goes upwards in
    `STEPS` or `NARROW_STEPS` per decade, and then between the last two values by Brent's method to
    rounding. Stiffness above the first unstable value is never called stable, even where a stable
    window may exist.
    """
    return _critical_N_m(loop.with_stiffness(SOFTEST_N_M))


@lru_cache(maxsize=64)
def _critical_N_m(loop: WallLoop) -> float:
    """Return the critical stiffness, cached for loops that differ only in their stiffness.

    The choice of a stiffness and its verdict then need one search.
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
    """Return the search steps per decade from a stiffness on.

    Steps are smaller where the undamped mass rings at f / 4 or above.
    """
    if loop.vibration is None:
        return STEPS
    turn = 0.5 * pi * loop.vibration.frequency_Hz
    mass = loop.mass_kg + loop.hand_mass_kg
    return NARROW_STEPS if stiffness_N_m + loop.hand_stiffness_N_m > mass * turn**2 else STEPS


def nearest_stable_N_m(critical_N_m: float) -> float:
    """Return a stable stiffness below the critical one, rounded down to three digits [N/m]."""
    if not 0.0 < critical_N_m < inf:
        return critical_N_m
    unit = 10.0 ** (floor(log10(critical_N_m)) - 2)
    return floor((1.0 - 1e-9) * critical_N_m / unit) * unit


def judge(loop: WallLoop, hands: Sequence[tuple[float, float, float]] | None = None) -> Verdict:
    """Judge the stability of a loop.

    With ``hands`` (see `in_hands`), the worst of these hands replaces the hand of the loop.
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
        If the wall is unstable in one of the hands. The message contains the margin and the nearest
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
    """Return the largest eigenvalue minus the limit of stability; no mode grows below zero."""
    return largest_eigenvalue(loop.with_stiffness(stiffness_N_m)) - (1.0 - ON_THE_CIRCLE)
