"""Estimates of a force: most probable force for an observation, and recursive filter.

No scene uses these estimates. They are the equations of the paper with corrections.
`tests/verification` compares them with a grid and with the steady state of the filter.
"""

from dataclasses import dataclass
from math import sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from tissue.materials.constants import constants

__all__ = ["LocalLevel", "log_posterior", "map_force_N"]

Level = TypeVar("Level", float, NDArray[np.float64])

MOST_STEPS = 200
"""Number of steps after which bisection alone has reduced a bracket to rounding."""


def log_posterior(
    log_force: Array, seen_N: Array, noise_N: Array, log_median: Array, log_spread: Array
) -> Array:
    """Return the logarithm of the density of F at u = ln F, up to a constant.

    It is -(u - m)^2 / 2 s^2 - u - (y - e^u)^2 / 2 r^2.
    """
    off = (log_force - log_median) / log_spread
    missed = (seen_N - np.exp(log_force)) / noise_N
    return -0.5 * off * off - log_force - 0.5 * missed * missed


def map_force_N(
    seen_N: ArrayLike,
    noise_N: ArrayLike,
    *,
    median_N: ArrayLike | None = None,
    log_spread: ArrayLike | None = None,
) -> Array:
    """Estimate the force [N] of largest posterior density, for any real observation.

    Observations may be zero or negative. The logarithm of the density has the slope g(u) = -(u - m)
    / s^2 - 1 + (y - e^u) e^u / r^2 in u = ln F. This slope either decreases everywhere, or it
    decreases, increases and decreases again. The intervals are separated by at most two points, the
    roots of 2 w^2 - y w + r^2 / s^2 in w = e^u. Every interval with decreasing g and a root of g
    has one maximum of the density. Each maximum is found by Newton's method within a bracket. The
    force of the higher maximum is returned.

    Parameters
    ----------
    seen_N
        Observation [N], any real numbers. All arguments are broadcast.
    noise_N
        Standard deviation of the observation [N], positive.
    median_N, log_spread
        Median [N] of the prior and the standard deviation of its logarithm; by default the values
        of ``perception.toml``.

    Returns
    -------
    Positive forces [N], with the broadcast shape.

    Raises
    ------
    InputError
        If an observation is not finite, or a parameter is not positive.
    """
    known = constants("perception", "force")
    median = known["prior_median_N"].value if median_N is None else median_N
    spread = known["prior_log_spread"].value if log_spread is None else log_spread
    y, r, middle, s = (np.asarray(each, dtype=float) for each in (seen_N, noise_N, median, spread))
    if not np.isfinite(y).all():
        raise InputError("seen_N", "be finite", "a value that is not", "leave that sample out")
    for name, value in (("noise_N", r), ("median_N", middle), ("log_spread", s)):
        if not ((value > 0.0) & np.isfinite(value)).all():
            raise InputError(name, "be positive and finite", np.min(value), "see perception.toml")
    y, r, m, s = np.broadcast_arrays(y, r, np.log(middle), s)
    shape = y.shape
    y, r, m, s = (each.ravel() for each in (y, r, m, s))
    turn = m - s * s  # mode of the prior
    with np.errstate(divide="ignore", invalid="ignore"):
        # Above the larger of ln y and the mode of the prior, g is negative; below the smaller one,
        # g is positive. All roots are therefore between them. For y <= 0 the term of the likelihood
        # is always negative, and its size at the mode gives the lower bound.
        highest = np.where(y > 0.0, np.maximum(np.log(y), turn), turn)
        reach = np.exp(turn)
        lowest = np.where(
            y > 0.0,
            np.minimum(np.log(y), turn),
            turn - s * s * ((np.abs(y) + reach) / r) * (reach / r),
        )
        # Roots of 2 w^2 - y w + r^2 / s^2. The larger root is computed directly, and the smaller
        # root from the product r^2 / (2 s^2) of the two roots, which avoids cancellation.
        inner = np.sqrt(y * y - 8.0 * (r / s) ** 2)
        two = (y > 0.0) & np.isfinite(inner)
        high_turn = np.where(two, np.log(0.25 * (y + inner)), np.inf)
        low_turn = np.where(two, np.log(0.5 * (r / s) ** 2) - high_turn, np.inf)
    best = _root(lowest, np.where(two, np.clip(low_turn, lowest, highest), highest), y, r, m, s)
    some = np.flatnonzero(two & (high_turn < highest))
    if len(some):
        part = [each[some] for each in (y, r, m, s)]
        other = _root(np.maximum(high_turn, lowest)[some], highest[some], *part)
        better = log_posterior(other, *part) > log_posterior(best[some], *part)
        best[some[better]] = other[better]
    return np.asarray(np.exp(best).reshape(shape))


def _root(low: Array, high: Array, y: Array, r: Array, m: Array, s: Array) -> Array:
    """Return the zero of the slope within brackets in which the slope decreases.

    For a bracket without a zero, return an end of the bracket.
    """
    low = low.copy()
    high = high.copy()
    u = 0.5 * (low + high)
    for _ in range(MOST_STEPS):
        w = np.exp(u)
        slope = -(u - m) / (s * s) - 1.0 + ((y - w) / r) * (w / r)
        bend = -1.0 / (s * s) + ((y - 2.0 * w) / r) * (w / r)
        low = np.where(slope > 0.0, u, low)
        high = np.where(slope > 0.0, high, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = u - slope / bend
        inside = (newton > low) & (newton < high)
        after = np.where(inside, newton, 0.5 * (low + high))
        # The tolerance is some tens of rounding errors of a double.
        done = np.abs(after - u) <= 1e-14 * (1.0 + np.abs(u))
        u = after
        if done.all():
            break
    return u


@dataclass(frozen=True, kw_only=True)
class LocalLevel:
    """Filter for a random walk with variance q per step, observed with variance r.

    Source: Kalman 1960::

        P = sigma^2 + q,   G = P / (P + r),   level += G (seen - level),   sigma^2 = G r

    The formula printed in the paper, sigma^2 = q r / (q + r), omits the last variance in P. For q =
    r = 1 it gives 0.5, but the steady state of the filter is (-q + sqrt(q^2 + 4 q r)) / 2 = 0.618.

    Attributes
    ----------
    wander, noise
        Variances q and r.
    """

    wander: float
    noise: float

    def __post_init__(self) -> None:
        # The bound 1e12 rejects infinity.
        require_range("wander", self.wander, 0.0, 1e12, "use 0 for a level that stays")
        require_positive("noise", self.noise, "use the variance of one observation")

    def step(self, level: Level, variance: float, seen: Level) -> tuple[Level, float]:
        """Return the level and the variance after one more observation; also for many levels."""
        predicted = variance + self.wander
        gain = predicted / (predicted + self.noise)
        return level + gain * (seen - level), gain * self.noise

    @property
    def steady_variance(self) -> float:
        """Variance after many observations."""
        return 0.5 * (sqrt(self.wander**2 + 4.0 * self.wander * self.noise) - self.wander)
