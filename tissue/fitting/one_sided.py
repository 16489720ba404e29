"""Constants whose cited value is an end of their range, such as axial cutting coefficients of 0.

A half-normal prior is positive in every draw: no interval of it holds the cited value, and every other constant that
the log cannot separate from it is shifted. The prior used here is a normal law cut off at the cited value, with the
part beyond the end counted as the end: half of the probability is the cited value itself, which is then the median,
and the other half has the far end of the range as its 95 % quantile.

A fit works with the whole normal law (``z`` of either sign, `tissue.materials.prior.Prior.mirrored`), under which the
posterior is close to normal. With the mean and covariance of the one-sided numbers in that posterior, the posterior
under the cut-off prior differs by a factor: the integral of the normal density times, for each number::

    0.5 delta(z) / phi(0) + (1 where z > 0)

which is the cut-off prior over the normal one.
"""

from functools import cache

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtri_exp

from meshes.base.arrays import Array

__all__ = ["END", "PRIOR_SPREAD", "log_factor"]

PRIOR_SPREAD = float(np.sqrt(0.5 - 0.5 / np.pi))
"""Standard deviation of a standard normal number of which the negative values are set to 0."""
END = float(0.5 * np.sqrt(2.0 * np.pi))
"""Probability of the end under the cut-off prior, over the density there under the normal one."""
POINTS = 256
"""Points of the quasi-random integral: its error is below 1 % for three correlated constants."""


def log_factor(mean: Array, covariance: Array) -> float:
    """Compute the logarithm of a normal posterior's probability under the cut-off prior over that under the normal one.

    The integral is sequential (Geweke, Hajivassiliou and Keane): number by number, each conditional law has its
    probability at zero and above zero in closed form.

    Parameters
    ----------
    mean, covariance
        Of the one-sided numbers under the normal prior, counted away from the end, shape (k,) and (k, k).
    """
    if not len(mean):
        return 0.0
    root = np.linalg.cholesky(covariance)
    uniform = _uniform(len(mean))
    drawn = np.zeros_like(uniform)
    logarithms = np.zeros(len(uniform))
    for at, spread in enumerate(np.diag(root).tolist()):
        ratio = (mean[at] + drawn[:, :at] @ root[at, :at]) / spread
        zero = np.log(0.5) - 0.5 * ratio**2 - np.log(spread)
        above = log_ndtr(ratio)
        both = np.logaddexp(zero, above)
        logarithms += both
        share = np.exp(zero - both)
        rest = np.clip((1.0 - uniform[:, at]) / np.maximum(1.0 - share, 1e-300), 1e-12, 1.0)
        drawn[:, at] = np.where(uniform[:, at] < share, -ratio, -ndtri_exp(np.log(rest) + above))
    return float(logsumexp(logarithms) - np.log(len(logarithms)))


@cache
def _uniform(count: int) -> Array:
    """Quasi-random points in the unit cube, shape (POINTS, count)."""
    from scipy.stats.qmc import Sobol

    return np.asarray(Sobol(count, scramble=True, rng=0).random(POINTS))
