"""The most probable force behind one noisy look at it: log-normal prior, Gaussian noise."""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.materials.constants import constants

__all__ = ["log_posterior", "map_force_N", "require_prior_fits"]

MOST_STEPS = 200
"""Steps after which a bracket has shrunk to rounding by bisection alone."""
FAR = 6.0
"""Standard deviations beyond which a prior excludes what was seen."""


def log_posterior(log_force: Array, seen_N: Array, noise_N: Array, log_median: Array, log_spread: Array) -> Array:
    """Logarithm of the density of F at u = ln F, up to a constant: -(u - m)^2 / 2 s^2 - u - (y - e^u)^2 / 2 r^2."""
    off, missed = (log_force - log_median) / log_spread, (seen_N - np.exp(log_force)) / noise_N
    return -0.5 * off * off - log_force - 0.5 * missed * missed


def map_force_N(
    seen_N: ArrayLike,
    noise_N: ArrayLike,
    *,
    median_N: ArrayLike | None = None,
    log_spread: ArrayLike | None = None,
) -> Array:
    """Force [N] of greatest posterior density, for observations that may be zero or negative (E7).

    In u = ln F the slope g(u) = -(u - m) / s^2 - 1 + (y - e^u) e^u / r^2 falls, rises and falls again, or only falls:
    between are at most two points, the roots of 2 w^2 - y w + r^2 / s^2 in w = e^u. Every falling piece that holds a
    root holds one maximum. Each is found by Newton's steps held within its bracket, and the higher one is kept.

    Parameters
    ----------
    seen_N
        What was observed [N], any real numbers; all arguments broadcast.
    noise_N
        Standard deviation of the observation [N], positive.
    median_N, log_spread
        Median [N] of the prior and the standard deviation of its logarithm; by default those of ``perception.toml``.

    Returns
    -------
    Positive forces [N], of the broadcast shape.

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
        raise InputError("seen_N must be finite, got a value that is not: leave that sample out")
    for name, value in (("noise_N", r), ("median_N", middle), ("log_spread", s)):
        if not ((value > 0.0) & np.isfinite(value)).all():
            raise InputError(f"{name} must be positive and finite, got {np.min(value)}: see perception.toml")
    y, r, m, s = np.broadcast_arrays(y, r, np.log(middle), s)
    shape = y.shape
    y, r, m, s = (each.ravel() for each in (y, r, m, s))
    turn = m - s * s  # mode of the prior
    with np.errstate(divide="ignore", invalid="ignore"):
        highest = np.where(y > 0.0, np.maximum(np.log(y), turn), turn)
        reach = np.exp(turn)
        lowest = np.where(y > 0.0, np.minimum(np.log(y), turn), turn - s * s * ((np.abs(y) + reach) / r) * (reach / r))
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


def require_prior_fits(seen_N: float, noise_N: float, *, median_N: float, log_spread: float) -> None:
    """Refuse a prior that excludes what was seen: further than six standard deviations of both laws.

    Raises
    ------
    InputError
        If the observation is that far from every force within six spreads of the prior's median.
    """
    require_positive("noise_N", noise_N, "use the standard deviation of an observation")
    require_positive("median_N", median_N, "use 1")
    require_positive("log_spread", log_spread, "use 1")
    low, high = median_N * np.exp(-FAR * log_spread), median_N * np.exp(FAR * log_spread)
    if not low - FAR * noise_N <= seen_N <= high + FAR * noise_N:
        raise InputError(
            f"seen_N must be possible under the prior of {median_N:g} N with log spread {log_spread:g}, got {seen_N} "
            f"with noise {noise_N:g} N: widen the prior or check the unit"
        )


def _root(low: Array, high: Array, y: Array, r: Array, m: Array, s: Array) -> Array:
    """Where the slope crosses zero within brackets on which it falls; an end where it does not."""
    low, high = low.copy(), high.copy()
    u = 0.5 * (low + high)
    for _ in range(MOST_STEPS):
        w = np.exp(u)
        slope = -(u - m) / (s * s) - 1.0 + ((y - w) / r) * (w / r)
        bend = -1.0 / (s * s) + ((y - 2.0 * w) / r) * (w / r)
        low, high = np.where(slope > 0.0, u, low), np.where(slope > 0.0, high, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = u - slope / bend
        inside = (newton > low) & (newton < high)
        after = np.where(inside, newton, 0.5 * (low + high))
        done = np.abs(after - u) <= 1e-14 * (1.0 + np.abs(u))
        u = after
        if done.all():
            break
    return u
