"""The law of residuals: autocorrelated of first order, with innovations that have Student's law."""

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, gammaln, polygamma

from meshes.base.arrays import Array

__all__ = ["NoiseTerms", "freedom_information", "innovations", "noise_terms", "place_information"]


@dataclass(frozen=True)
class NoiseTerms:
    """Log density of residuals and its derivatives for an optimiser.

    Attributes
    ----------
    log_density
        Summed over samples and channels.
    by_residuals
        Derivative by each residual, shape (m, channels). It is 0 where there is no residual.
    by_log_scale, by_correlation, by_freedom
        Derivatives by ln scale, the correlation and the degrees of freedom of each channel, shape
        (channels,).
    weights
        Weight of each squared innovation in the sum of squares with the same gradient, shape (m,
        channels) [1/unit²].
    """

    log_density: float
    by_residuals: Array
    by_log_scale: Array
    by_correlation: Array
    by_freedom: Array
    weights: Array


def innovations(residuals: Array, correlation: Array) -> Array:
    """Return the innovations e_t = r_t - phi r_(t-1) of residuals, shape (m, channels).

    The first innovation after a gap (NaN) is sqrt(1 - phi²) r_t, since the chain starts stationary.
    It is NaN at gaps. The innovations are linear in the residuals. A third axis of derivatives is
    therefore possible: shape (m, channels, any).
    """
    previous, starts = _previous(residuals)
    phi = correlation.reshape(1, -1, *[1] * (residuals.ndim - 2))
    return np.where(starts, np.sqrt(1.0 - phi**2) * residuals, residuals - phi * previous)


def noise_terms(residuals: Array, scale: Array, correlation: Array, freedom: Array) -> NoiseTerms:
    """Compute the log density of residuals and its gradient.

    Parameters
    ----------
    residuals
        Residuals at one rate, shape (m, channels), NaN where missing.
    scale
        Scale of the innovations, shape (channels,). At four degrees of freedom, the standard
        deviation is sqrt(2) times the scale.
    correlation
        Correlation of neighbouring residuals, in (-1, 1), shape (channels,).
    freedom
        Degrees of freedom of the innovations, shape (channels,). With fewer degrees of freedom,
        outliers have less influence.
    """
    previous, starts = _previous(residuals)
    here = np.isfinite(residuals)
    e = np.where(here, innovations(residuals, correlation), 0.0)
    spread = freedom * scale**2 + e**2
    weights = np.where(here, (freedom + 1.0) / spread, 0.0)
    pull = weights * e
    stationary = 1.0 - correlation**2
    count = here.sum(axis=0)
    begun = starts.sum(axis=0)
    constant = (
        gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi)
    )
    density = count * (constant - np.log(scale)) + 0.5 * begun * np.log(stationary)
    tails = np.log1p(e**2 / (freedom * scale**2)).sum(axis=0)
    density -= 0.5 * (freedom + 1.0) * tails
    pulled = np.sum(pull * e, axis=0)
    by_freedom = digamma(0.5 * (freedom + 1.0)) - digamma(0.5 * freedom) - 1.0 / freedom
    by_freedom = 0.5 * (count * by_freedom - tails + pulled / freedom)
    by_residuals = -pull * np.where(starts, np.sqrt(stationary), 1.0)
    follows = here[1:] & np.logical_not(starts[1:])
    by_residuals[:-1] += np.where(follows, correlation * pull[1:], 0.0)
    moved = np.where(starts, -correlation / np.sqrt(stationary) * residuals, -previous)
    by_correlation = (
        -np.sum(pull * np.where(here, moved, 0.0), axis=0) - begun * correlation / stationary
    )
    return NoiseTerms(
        float(density.sum()), by_residuals, pulled - count, by_correlation, by_freedom, weights
    )


def place_information(freedom: Array) -> Array:
    """Return the Fisher information of the place of an innovation of scale 1, shape of freedom.

    The formula is from Lange, Little and Taylor (1989).
    """
    return (freedom + 1.0) / (freedom + 3.0)


def freedom_information(freedom: Array) -> tuple[Array, Array]:
    """Return the Fisher information of the degrees of freedom, and its cross term with ln scale.

    The formulas are from Lange, Little and Taylor (1989). Both have the shape of freedom.
    """
    curved = 0.25 * (polygamma(1, 0.5 * freedom) - polygamma(1, 0.5 * (freedom + 1.0)))
    of_freedom = curved - 0.5 * (freedom + 5.0) / (freedom * (freedom + 1.0) * (freedom + 3.0))
    return np.asarray(of_freedom), -2.0 / ((freedom + 1.0) * (freedom + 3.0))


def _previous(residuals: Array) -> tuple[Array, Array]:
    """Return the previous residual of each residual, or zero, and the start flags of chains."""
    previous = np.concatenate([np.full_like(residuals[:1], np.nan), residuals[:-1]])
    starts = np.isfinite(residuals) & np.isnan(previous)
    return np.where(np.isfinite(previous), previous, 0.0), starts
