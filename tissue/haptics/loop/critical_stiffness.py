"""Stability of a virtual wall on a haptic device, from eigenvalues of the sampled loop.

The result is known before the device runs. The delay of the loop is modelled without approximation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import floor, inf, log10, pi
from typing import NamedTuple

import numpy as np

from meshes.base.errors import require_positive, require_range
from meshes.base.hints import suggests_arguments
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.sampled_loop import WallLoop, growth_per_model_step, spectral_radius

SOFTEST_N_M = 1e-2
STIFFEST_N_M = 1e8
"""Search range of the critical stiffness: `SOFTEST_N_M` to `STIFFEST_N_M` [N/m]."""
STEPS = 4
NARROW_STEPS = 24
"""Search steps per decade of stiffness where narrow unstable windows may exist.

Elsewhere, `STEPS` steps per decade are used.

A window is a narrow range of stiffness in which the loop is unstable. It may exist where the loop
oscillates at half the frequency of the vibration of a cutter's teeth. Vibrations of 5 to 60 Hz,
with amplitudes up to the average force, were tried on a Touch. With 24 steps, the search misses
only windows in which the oscillation grows by less than 1 / 5000 per tick. With 16 steps, it also
misses windows in which the oscillation grows by 1 / 700 per tick.
"""
STABILITY_TOLERANCE = 1e-12
"""Tolerance with which the magnitude of an eigenvalue is compared with the stability limit 1.

A magnitude above 1 minus this value is treated as unstable, because an eigenvalue of exactly 1 may
be rounded to slightly less than 1. Such an eigenvalue occurs with a very soft wall, whose force
does not move the device.
"""


@suggests_arguments
@dataclass(frozen=True)
class Verdict:
    """Stability of a loop, computed before the loop runs.

    Attributes
    ----------
    stable
        True if every mode of the loop decays for each of the given hands.
    margin
        Stability margin 1 - K / K_critical, with the wall stiffness K. The margin is 0 at the
        stability limit, and negative above the limit.
    critical_N_m
        Lowest stiffness [N/m] at which a mode does not decay, for the hand with the lowest value.
    nearest_N_m
        The given stiffness if it is stable, otherwise the nearest stable stiffness, rounded down to
        three digits [N/m].
    spectral_radius
        Growth factor per tick of the mode that decays most slowly, for the hand with the largest
        factor.
    """

    stable: bool
    margin: float
    critical_N_m: float
    nearest_N_m: float
    spectral_radius: float

    def sentence(self, stiffness_N_m: float) -> str:
        """Return a sentence that describes the stability at a stiffness [N/m]."""
        if self.critical_N_m == inf:
            return f"stiffness {stiffness_N_m:.4g} N/m is stable, and so is every other"
        if self.stable:
            return (
                f"stiffness {stiffness_N_m:.4g} N/m is stable, {100.0 * self.margin:.1f} % below "
                f"the critical value of {self.critical_N_m:.4g} N/m"
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


class LinearHand(NamedTuple):
    """Linear part of a hand, for the stability analysis of a loop.

    The entries are also fields of `WallLoop`. Without a hand, all entries are zero.
    """

    hand_stiffness_N_m: float
    hand_damping_N_s_m: float
    hand_mass_kg: float
    reflex_N_m: float = 0.0
    reflex_s: float = 0.0


def in_hands(loop: WallLoop, hands: Sequence[tuple[float, ...]]) -> tuple[WallLoop, ...]:
    """Return one copy of the loop for each hand, given as the values of `LinearHand`'s fields."""
    return tuple(replace(loop, **LinearHand(*each)._asdict()) for each in hands)


def settling_hands(loop: WallLoop, hands: Sequence[LinearHand]) -> tuple[LinearHand, ...]:
    """Return the hands that hold the device without oscillation if there is no virtual wall.

    The reflex may make a hand oscillate even without a wall. Such a hand is not used to choose a
    coupling stiffness, because the hand may oscillate with any stiffness.
    """
    alone = replace(loop, stiffness_N_m=0.0, wall_damping_N_s_m=0.0, forecast=None)
    return tuple(
        hand
        for hand in hands
        if hand.reflex_N_m == 0.0 or spectral_radius(in_hands(alone, [hand])[0]) < 1.0
    )


@suggests_arguments
def critical_stiffness_N_m(loop: WallLoop) -> float:
    """Return the lowest stiffness at which the loop is unstable [N/m].

    The result is 0 if the loop is unstable with the softest wall, and inf if it is stable with
    every wall. The search starts at the softest wall, with `STEPS` or `NARROW_STEPS` steps per
    decade. Between the last stable and the first unstable value, Brent's method refines the result
    with a relative tolerance of 1e-10. Each stiffness above the result is reported as unstable,
    even if stable windows exist there.
    """
    return _critical_N_m(loop.with_stiffness(SOFTEST_N_M))


# A study checks about 250 loops repeatedly: methods, hands of three groups, and tasks. An entry has
# a few kilobytes.
@lru_cache(maxsize=1024)
def _critical_N_m(loop: WallLoop) -> float:
    """Return the critical stiffness of a loop, with a cache.

    The result does not depend on the stiffness in `loop`. `critical_stiffness_N_m` therefore
    replaces this stiffness by a constant, so that the choice and the check of a stiffness need only
    one search.
    """
    from scipy.optimize import brentq

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
    """Return the number of search steps per decade above a stiffness.

    If the loop has a vibration of frequency f, the steps are smaller for stiffnesses at which the
    undamped mass oscillates at f / 4 or above. Unstable windows occur where the loop oscillates
    near f / 2, but damping and delay lower the frequency of the loop.
    """
    if loop.vibration is None:
        return STEPS
    turn = 0.5 * pi * loop.vibration.frequency_Hz
    mass = loop.mass_kg + loop.hand_mass_kg
    return NARROW_STEPS if stiffness_N_m + loop.hand_stiffness_N_m > mass * turn**2 else STEPS


def nearest_stable_N_m(critical_N_m: float) -> float:
    """Round the critical stiffness down to a stable stiffness with three digits [N/m]."""
    if not 0.0 < critical_N_m < inf:
        return critical_N_m
    unit = 10.0 ** (floor(log10(critical_N_m)) - 2)
    # 1e-9: a critical value with exactly three digits must be rounded down, too.
    return floor((1.0 - 1e-9) * critical_N_m / unit) * unit


@suggests_arguments
def judge(loop: WallLoop, hands: Sequence[tuple[float, ...]] | None = None) -> Verdict:
    """Check the stability of a loop.

    If ``hands`` are given (see `in_hands`), these hands replace the hand of the loop. The result is
    then valid for the least stable hand.
    """
    loops = (loop,) if hands is None else in_hands(loop, hands)
    critical = min(critical_stiffness_N_m(each) for each in loops)
    stiffness = loop.stiffness_N_m
    stable = stiffness < critical
    margin = 1.0 - stiffness / critical if critical > 0.0 else -inf
    nearest = stiffness if stable else nearest_stable_N_m(critical)
    return Verdict(stable, margin, critical, nearest, max(spectral_radius(each) for each in loops))


def _beyond(stiffness_N_m: float, loop: WallLoop) -> float:
    """Return the largest eigenvalue minus the stability limit; negative for a stable loop."""
    return growth_per_model_step(loop.with_stiffness(stiffness_N_m)) - (1.0 - STABILITY_TOLERANCE)


def passive_bound_N_m(loop: WallLoop) -> float:
    """Return the largest stiffness of a passive wall (Colgate and Schenkel, 1997) [N/m].

    With a passive wall, the loop is stable for any passive hand. The bound is the largest K that
    satisfies b > T / 2 Re{(1 - exp(-j w T)) H} / (1 - cos w T) on a grid of frequencies w. b is the
    damping of the device alone. T is the time for which a force is held. If the tissue model is
    slower than the loop, T is the step of the tissue model. H is the product of the transfer
    functions of the wall (stiffness K, damping B), the filter and the delay. The delay is rounded
    up to whole steps and includes the lag of the amplifier. For a slow model with a filter, which
    changes the held force within a step, one more step of delay is added. Without delay and filter,
    the bound is 2 (b - |B|) / T. The result is 0 if no stiffness is passive.
    """
    step = loop.tick_s * loop.model_ticks
    lag = loop.delay_s + 1.0 / (2.0 * pi * loop.amplifier_Hz)
    # The lowest frequencies determine the bound. Without frequencies below 0.01 the bound is up to
    # 5 times as high; with frequencies from 1e-4 it is up to 4 % lower.
    turn = np.concatenate([np.geomspace(1e-3, 1e-2, 100), np.linspace(1e-2, np.pi, 4000)])
    back = np.exp(-1j * turn)
    gain = low_pass_gain(loop.filter_s, step)
    passed = (
        gain
        / (1.0 - (1.0 - gain) * back)
        # 1e-9: a lag of whole steps must not be rounded up to one more step.
        * back ** (np.ceil(lag / step - 1e-9) + (gain < 1.0 and loop.model_ticks > 1))
    )
    paid = 2.0 * loop.damping_N_s_m / step * (1.0 - np.cos(turn))
    owed_to_damping = ((1.0 - back) ** 2 * passed).real * loop.wall_damping_N_s_m / step
    owed_to_stiffness = ((1.0 - back) * passed).real
    left = paid - owed_to_damping
    if (left < 0.0).any():
        return 0.0
    owing = owed_to_stiffness > 0.0
    return float((left[owing] / owed_to_stiffness[owing]).min())


def delay_bound_N_m(loop: WallLoop) -> float:
    """Return the bound K = (b + B) / (T / 2 + t_d) for a delayed wall (Gil et al., 2009) [N/m].

    b is the damping of device and hand, B the damping of the wall, T the time for which a force is
    held, and t_d the delay. For a loop with delay, the bound is a first-order estimate and may be
    larger than the true limit.
    """
    damping = loop.damping_N_s_m + loop.hand_damping_N_s_m + loop.wall_damping_N_s_m
    return max(damping / (0.5 * loop.tick_s * loop.model_ticks + loop.delay_s), 0.0)


def quantised_bound_N_m(loop: WallLoop, *, friction_N: float, encoder_m: float) -> float:
    """Return the bound K = min(2 b / T, 2 f_c / D) for a wall with encoder steps [N/m].

    Source: Abbott and Okamura, 2005.

    b is the damping of the device, T the time for which a force is held, f_c the Coulomb friction
    and D the encoder step.
    """
    require_range(
        "friction_N", friction_N, 0.0, 1e3, "give the device's Coulomb friction, 0 for none"
    )
    require_positive("encoder_m", encoder_m, "give the device's encoder step, such as 5.5e-5")
    return min(
        2.0 * loop.damping_N_s_m / (loop.tick_s * loop.model_ticks), 2.0 * friction_N / encoder_m
    )


def pade_bound_N_m(loop: WallLoop) -> float:
    """Return the critical stiffness [N/m] for a first-order Padé approximation of the delay.

    The zero-order hold over the time T and the delay t_d are combined into one delay t = t_d + T /
    2. This delay is approximated as (1 - t s / 2) / (1 + t s / 2). The bound follows from Routh's
    criterion for the characteristic polynomial of third order. The hand's stiffness is ignored.
    """
    delay = loop.delay_s + 0.5 * loop.tick_s * loop.model_ticks
    mass = loop.mass_kg + loop.hand_mass_kg
    damping = loop.damping_N_s_m + loop.hand_damping_N_s_m
    cubic = 0.5 * mass * delay
    constant = damping + loop.wall_damping_N_s_m
    square = mass + 0.5 * delay * (damping - loop.wall_damping_N_s_m)
    return max(square * constant / (cubic + 0.5 * delay * square), 0.0)
