"""Psychometric functions: how often an answer is right, over the strength of what is felt."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range

__all__ = [
    "D_PRIME_75",
    "correct_of_d_prime",
    "cumulative_normal",
    "d_prime_of_correct",
    "log_normal",
    "two_interval",
    "weibull",
    "with_lapse",
]

D_PRIME_75 = 0.9538725524089894
"""Distance d' of two intervals at which 75 % of the answers are right: sqrt(2) Phi^-1(0.75)."""


def with_lapse(share: ArrayLike, *, guess: float = 0.5, lapse: ArrayLike = 0.0) -> Array:
    """Share of right answers guess + (1 - guess - lapse) share (Wichmann and Hill, 2001).

    Parameters
    ----------
    share
        Share that is felt rightly without guesses and lapses, in [0, 1], any shape.
    guess
        Share that is right where nothing is felt: 1/2 for two intervals.
    lapse
        Share of strong stimuli that is answered wrongly.
    """
    require_range("guess", guess, 0.0, 0.999, "use 0.5 for two intervals")
    lapses = np.asarray(lapse, dtype=float)
    if not ((lapses >= 0.0) & (lapses < 1.0 - guess)).all():
        raise InputError(f"lapse must be in [0, {1.0 - guess:g}), got {lapse!r}: use 0.02")
    return guess + (1.0 - guess - lapses) * np.asarray(share, dtype=float)


def weibull(
    strength: ArrayLike, threshold: float, slope: float, *, guess: float = 0.5, lapse: ArrayLike = 0.0
) -> Array:
    """Weibull function: 1 - exp(-(x / threshold)^slope) between guess and lapse; x >= 0, any shape."""
    _positive("threshold", threshold)
    _positive("slope", slope)
    felt = -np.expm1(-((_strength(strength, 0.0) / threshold) ** slope))
    return with_lapse(felt, guess=guess, lapse=lapse)


def cumulative_normal(
    strength: ArrayLike, mean: float, spread: float, *, guess: float = 0.5, lapse: ArrayLike = 0.0
) -> Array:
    """Cumulative normal function of any real x between guess and lapse; `spread` is a standard deviation."""
    _positive("spread", spread)
    return with_lapse(ndtr((_strength(strength, -np.inf) - mean) / spread), guess=guess, lapse=lapse)


def log_normal(
    strength: ArrayLike, median: float, log_spread: float, *, guess: float = 0.5, lapse: ArrayLike = 0.0
) -> Array:
    """Cumulative normal function of ln x between guess and lapse; x >= 0, median > 0."""
    _positive("median", median)
    _positive("log_spread", log_spread)
    with np.errstate(divide="ignore"):
        place = (np.log(_strength(strength, 0.0)) - np.log(median)) / log_spread
    return with_lapse(ndtr(place), guess=guess, lapse=lapse)


def correct_of_d_prime(d_prime: ArrayLike) -> Array:
    """Share of right answers in two intervals: Phi(d' / sqrt(2)) (Green and Swets, 1966)."""
    return ndtr(np.asarray(d_prime, dtype=float) / np.sqrt(2.0))


def d_prime_of_correct(share: ArrayLike) -> Array:
    """Distance d' at which a share in (0, 1) of the answers in two intervals is right: sqrt(2) Phi^-1(share).

    0.771 at 70.7 %, 0.954 at 75 %, 1.159 at 79.4 %.
    """
    shares = np.asarray(share, dtype=float)
    if not ((shares > 0.0) & (shares < 1.0)).all():
        raise InputError(f"share must be in (0, 1), got {share!r}: a session without an error only bounds d'")
    return np.sqrt(2.0) * ndtri(shares)


def two_interval(
    base_N: ArrayLike, step_N: ArrayLike, weber: ArrayLike, offset_N: ArrayLike, lapse: ArrayLike = 0.0
) -> Array:
    """Share of right answers to which of two forces was greater, `base_N` or `base_N + step_N`.

    The distance d' grows with the step and is 0.954 (75 %) at the threshold weber (base + offset), which is Weber's law
    with its term for low forces. Arguments broadcast.

    Parameters
    ----------
    base_N, step_N
        The smaller force, and how much greater the other is [N].
    weber
        Weber fraction, positive.
    offset_N
        Force that Weber's law is short of at low forces [N].
    lapse
        Share of strong stimuli that is answered wrongly.
    """
    base, step = _strength(base_N, 0.0), _strength(step_N, 0.0)
    distance = D_PRIME_75 * step / (np.asarray(weber, dtype=float) * (base + np.asarray(offset_N, dtype=float)))
    return with_lapse(2.0 * correct_of_d_prime(distance) - 1.0, lapse=lapse)


def _positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise InputError(f"{name} must be positive and finite, got {value}: use 1")


def _strength(values: ArrayLike, lowest: float) -> Array:
    """Strengths as an array, none below the lowest that makes sense."""
    strengths = np.asarray(values, dtype=float)
    if not (strengths >= lowest).all():
        raise InputError(f"strength must be a number of at least {lowest:g}, got {values!r}: forces are sizes")
    return strengths
