"""Sizes of effects with exact intervals from noncentral distributions."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import nctdtrinc
from scipy.stats import ncf

from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import LEVEL, Effect

__all__ = ["cohens_d", "partial_eta_squared"]

TAILS = (0.5 * (1.0 + LEVEL), 0.5 * (1.0 - LEVEL))
"""Chances of a figure below the measured one at the lower and at the upper end of an interval."""


def cohens_d(first: ArrayLike, second: ArrayLike, *, paired: bool = False) -> Effect:
    """Difference of two means in standard deviations (Cohen 1988), interval from the noncentral t distribution.

    The interval (Steiger and Fouladi 1997) is exact for normal samples of equal variance.

    Parameters
    ----------
    first, second
        Samples, one finite value a user, two or more; for paired ones entry i of both is the same user.
    paired
        Divide by the standard deviation of the differences ("d of differences"), not by the pooled one of the samples.
        The two answer different questions and are named apart.

    Raises
    ------
    InputError
        If the samples do not vary.
    """
    one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if paired:
        spread, degrees, scale = float((one - other).std(ddof=1)), len(one) - 1, len(one) ** 0.5
    else:
        degrees = len(one) + len(other) - 2
        spread = float(np.sqrt((one.var() * len(one) + other.var() * len(other)) / degrees))
        scale = (len(one) * len(other) / (len(one) + len(other))) ** 0.5
    if spread == 0.0:
        raise InputError("samples must vary within, got a spread of 0: a difference has then no standard size")
    value = float(one.mean() - other.mean()) / spread
    low, high = (float(nctdtrinc(degrees, chance, value * scale)) / scale for chance in TAILS)
    return Effect("Cohen's d of differences" if paired else "Cohen's d", value, low, high)


def partial_eta_squared(statistic: float, above: float, below: float) -> Effect:
    """Share of variation that an effect explains beside its error, from F (Cohen 1973).

    The interval (Steiger 2004) is L / (L + above + below + 1) of the noncentralities L of F at its ends.

    Parameters
    ----------
    statistic, above, below
        F and its degrees of freedom.
    """
    value = statistic * above / (statistic * above + below)
    ends = (_noncentrality(statistic, above, below, chance) for chance in TAILS)
    low, high = (end / (end + above + below + 1.0) for end in ends)
    return Effect("partial eta squared", value, low, high)


def _noncentrality(statistic: float, above: float, below: float, chance: float) -> float:
    """Noncentrality at which an F below the given one has this chance; zero where even that makes it rarer."""

    def excess(shift: float) -> float:
        return chance - float(ncf.cdf(statistic, above, below, shift))

    if excess(0.0) >= 0.0:
        return 0.0
    high = 1.0 + statistic * above
    while excess(high) < 0.0:
        high *= 2.0
    return float(brentq(excess, 0.0, high, xtol=1e-9))
