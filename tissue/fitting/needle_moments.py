"""When a force jumps, by the likelihood of every moment at which it may.

Before the jump one law holds, after it another, and the noise is a chain with Student's innovations
(`tissue.fitting.noise`). A sample over which the jump falls is the mean of both. The innovations of all samples but
that one and the next do not depend on where it is, so that running sums give the likelihood of every moment at once.
"""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.noise import innovations
from tissue.fitting.target import Unpacked

__all__ = ["Moment", "moment_densities", "moment_of"]

NEGLIGIBLE = 8.0
"""How far below the most likely moment others are left out: 3e-4 of its density."""
ALIKE = 1.0
"""Difference of log density up to which moments count as equally likely."""


@dataclass(frozen=True)
class Moment:
    """The law of the moment of a jump.

    Attributes
    ----------
    mean_s, spread_s
        Mean and standard deviation [s].
    early_s
        The first one that is about as likely as the most likely one [s].
    span_s
        From the first to the last that is not negligible [s].
    """

    mean_s: float
    spread_s: float
    early_s: float
    span_s: tuple[float, float]


def moment_densities(before: Array, after: Array, parts: int, noise: Unpacked) -> Array:
    """Log density of one channel for a jump in each part of each sample, shape (m, parts), up to a constant.

    Parameters
    ----------
    before, after
        Residuals of the law before the jump and after it, shape (m,), NaN where nothing is known.
    parts
        Readings of which a sample is the mean: the jump comes before the first of them, or between two.
    noise
        Scale, correlation and degrees of freedom of the noise, of one channel.
    """
    scale, phi, freedom = float(noise.scale[0]), float(noise.correlation[0]), float(noise.freedom[0])

    def density(innovation: Array) -> Array:
        terms = -0.5 * (freedom + 1.0) * np.log1p(innovation**2 / (freedom * scale**2))
        return np.asarray(np.where(np.isfinite(terms), terms, 0.0))

    def following(residual: Array, previous: Array) -> Array:
        start = np.sqrt(1.0 - phi**2) * residual
        return np.where(np.isfinite(previous), residual - phi * previous, start)

    gone = density(innovations(before[:, None], noise.correlation)[:, 0])
    coming = density(innovations(after[:, None], noise.correlation)[:, 0])
    share = np.arange(parts) / parts
    mixed = share * before[:, None] + (1.0 - share) * after[:, None]
    last = np.concatenate([[np.nan], before[:-1]])[:, None]
    next_ = np.concatenate([after[1:], [np.nan]])[:, None]
    rest = np.concatenate([np.cumsum(coming[::-1])[::-1], [0.0, 0.0]])[2:]
    earlier = np.concatenate([[0.0], np.cumsum(gone)[:-1]])
    two = density(following(mixed, last)) + density(following(next_, mixed))
    return np.asarray(earlier[:, None] + two + rest[:, None])


def moment_of(times_s: Array, within_s: tuple[float, ...], densities: Array) -> Moment:
    """The law of a moment from its log densities.

    Parameters
    ----------
    times_s
        Of the samples, shape (m,) [s].
    within_s
        Times of their readings from these, k of them [s]: a jump comes half a reading before one.
    densities
        Shape (m, k), -inf where there is none.
    """
    rate_s = float(np.median(np.diff(times_s))) / len(within_s)
    moments = (times_s[:, None] + np.array(within_s) - 0.5 * rate_s).ravel()
    logarithms = densities.ravel() - densities.max()
    shares = np.exp(logarithms)
    shares /= shares.sum()
    mean = float(shares @ moments)
    spread = float(np.sqrt(shares @ (moments - mean) ** 2 + rate_s**2 / 12.0))
    likely = moments[logarithms > -NEGLIGIBLE]
    early = float(moments[int(np.argmax(logarithms > -ALIKE))])
    return Moment(mean, spread, early, (float(likely[0]), float(likely[-1])))
