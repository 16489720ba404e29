"""Sizes of effects with exact intervals from noncentral distributions."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import chi2, ncf, nct

from meshes.base.errors import InputError
from tissue.evaluation.statistics.outcome import LEVEL, Effect

__all__ = ["cohens_d", "partial_eta_squared"]

FAR = 1e4
"""A t beyond which its noncentral distribution is taken at its limit, to 1e-4."""


def cohens_d(first: ArrayLike, second: ArrayLike, *, paired: bool = False, level: float = LEVEL) -> Effect:
    """Difference of two means in standard deviations (Cohen 1988), interval from the noncentral t distribution.

    Parameters
    ----------
    first, second
        Samples, one value a user; for paired ones entry i of both is the same user.
    paired
        Divide by the standard deviation of the differences ("d of differences"), not by the pooled one of the samples.
        The two answer different questions and are named apart.
    level
        Coverage of the interval (Steiger and Fouladi 1997), exact for normal samples of equal variance.
    """
    one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if paired and one.shape != other.shape:
        raise InputError(f"paired samples must be of one length, got {len(one)} and {len(other)}: pair them by user")
    for name, sample in (("first", one), ("second", other)):
        if sample.ndim != 1 or len(sample) < 2 or not np.isfinite(sample).all():
            raise InputError(f"{name} must hold at least two finite values, got {sample.size}: add users")
    if paired:
        difference = one - other
        spread, degrees, scale = float(difference.std(ddof=1)), len(one) - 1, len(one) ** 0.5
    else:
        degrees = len(one) + len(other) - 2
        squares = ((one - one.mean()) ** 2).sum() + ((other - other.mean()) ** 2).sum()
        spread = float(np.sqrt(squares / degrees))
        scale = (len(one) * len(other) / (len(one) + len(other))) ** 0.5
    if spread == 0.0:
        raise InputError("samples must vary within, got a spread of 0: a difference has then no standard size")
    value = float(one.mean() - other.mean()) / spread
    low, high = _limits(lambda shift: _t_above(value * scale, degrees, shift), value * scale, level, -np.inf)
    return Effect("Cohen's d of differences" if paired else "Cohen's d", value, low / scale, high / scale)


def partial_eta_squared(statistic: float, above: float, below: float, *, level: float = LEVEL) -> Effect:
    """Share of variation that an effect explains beside its error, from F (Cohen 1973); interval by Steiger (2004).

    Parameters
    ----------
    statistic, above, below
        F and its degrees of freedom.
    level
        Coverage of the interval, from the noncentral F distribution with noncentrality L: L / (L + above + below + 1).
    """
    value = statistic * above / (statistic * above + below)
    low, high = _limits(lambda shift: float(ncf.sf(statistic, above, below, shift)), statistic * above, level, 0.0)
    total = above + below + 1.0
    return Effect("partial eta squared", value, low / (low + total), high / (high + total))


def _t_above(t: float, degrees: int, shift: float) -> float:
    """Chance of a noncentral t above `t`."""
    if abs(t) < FAR:
        return float(nct.sf(t, degrees, shift))
    # So far out the normal part is a constant beside the spread's, whose series does not end.
    near = float(chi2.cdf(degrees * (shift / t) ** 2, degrees)) if shift * t > 0.0 else 0.0
    return near if t > 0.0 else 1.0 - near


def _limits(chance_above: Callable[[float], float], start: float, level: float, lowest: float) -> tuple[float, float]:
    """Noncentralities at which a figure this large or larger has the chance (1 - level) / 2, and 1 minus it."""
    tail = 0.5 * (1.0 - level)
    found = []
    for wanted in (tail, 1.0 - tail):
        width = 4.0 + abs(start) * 0.5
        left, right = max(lowest, start - width), start + width
        while left > lowest and chance_above(left) > wanted:
            left, width = max(lowest, left - width), 2.0 * width
        if left == lowest and chance_above(left) > wanted:
            found.append(lowest)
            continue
        while chance_above(right) < wanted:
            right, width = right + width, 2.0 * width
        found.append(float(brentq(lambda shift, wanted=wanted: chance_above(shift) - wanted, left, right, xtol=1e-9)))
    return found[0], found[1]
