"""Stevens' factor and exponent from the numbers that a person gives to forces."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import digamma, polygamma
from scipy.stats import t

from meshes.base.arrays import Array

__all__ = ["MAGNITUDE_FORCES_N", "MagnitudePosterior", "fit_magnitudes"]

MAGNITUDE_FORCES_N = (0.3, 0.5, 0.8, 1.3, 2.0, 3.2)
"""Forces that are given numbers [N]: equal ratios over what a desktop device plays."""
PRIOR_MEAN = (0.0, 1.4)
"""Prior mean of ln alpha and of beta: between palm pressure (1.1) and muscle force (1.7)."""
PRIOR_WEIGHT = 1.0 / 16.0
"""Precision of both, in units of that of one report: at a scatter of 0.25 their standard deviation is 1."""
PRIOR_SHAPE, PRIOR_SCALE = 2.0, 0.12
"""Inverse-gamma prior of sigma^2: mean 0.12, a scatter of about 0.3."""


@dataclass(frozen=True)
class MagnitudePosterior:
    """Normal-inverse-gamma posterior of ln S = ln alpha + beta ln F + sigma e (Gelman et al., 2013, section 14.2).

    Attributes
    ----------
    mean
        Mean of (ln alpha, beta), shape (2,).
    precision
        Their precision in units of 1 / sigma^2, shape (2, 2).
    shape, scale
        Of the inverse-gamma posterior of sigma^2.
    """

    mean: Array
    precision: Array
    shape: float
    scale: float

    @property
    def covariance(self) -> Array:
        """Covariance of (ln alpha, beta), shape (2, 2)."""
        return np.asarray(self.scale / (self.shape - 1.0) * np.linalg.inv(self.precision))

    def log_sigma(self) -> tuple[float, float]:
        """Mean and variance of ln sigma."""
        return 0.5 * float(np.log(self.scale) - digamma(self.shape)), 0.25 * float(polygamma(1, self.shape))

    def exponent_at(self, shares: ArrayLike) -> Array:
        """Quantiles of the exponent beta."""
        width = np.sqrt(self.scale / self.shape * np.linalg.inv(self.precision)[1, 1])
        return self.mean[1] + width * t.ppf(shares, 2.0 * self.shape)


def fit_magnitudes(forces_N: ArrayLike, numbers: ArrayLike) -> MagnitudePosterior:
    """Posterior after some reports; without any it is the prior.

    The factor is that of a person's numbers: it cannot be separated from how the person uses them.

    Parameters
    ----------
    forces_N
        Forces [N], positive, shape (n,).
    numbers
        Numbers that were given to them, positive, shape (n,).
    """
    log_forces, logarithms = np.log(forces_N), np.log(numbers)
    design = np.column_stack([np.ones(len(log_forces)), log_forces])
    prior = PRIOR_WEIGHT * np.eye(2)
    precision = prior + design.T @ design
    start = np.array(PRIOR_MEAN)
    mean = np.linalg.solve(precision, prior @ start + design.T @ logarithms)
    scale = PRIOR_SCALE + 0.5 * float(logarithms @ logarithms + start @ prior @ start - mean @ precision @ mean)
    return MagnitudePosterior(mean, precision, PRIOR_SHAPE + 0.5 * len(design), scale)
