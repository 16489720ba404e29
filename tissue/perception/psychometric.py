"""Psychometric functions of two intervals: how often an answer is right, over the strength of what is felt."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from meshes.base.arrays import Array

__all__ = ["D_PRIME_75", "correct_of_d_prime", "two_interval", "with_lapse"]

D_PRIME_75 = 0.9538725524089894
"""Distance d' of two intervals at which 75 % of the answers are right: sqrt(2) Phi^-1(0.75)."""


def with_lapse(share: ArrayLike, lapse: ArrayLike) -> Array:
    """Share of right answers 1/2 + (1/2 - lapse) share in two intervals (Wichmann and Hill, 2001).

    Parameters
    ----------
    share
        Share that is felt rightly without guesses and lapses, in [0, 1], any shape.
    lapse
        Share of strong stimuli that is answered wrongly, in [0, 1/2).
    """
    return 0.5 + (0.5 - np.asarray(lapse, dtype=float)) * np.asarray(share, dtype=float)


def correct_of_d_prime(d_prime: ArrayLike) -> Array:
    """Share of right answers in two intervals: Phi(d' / sqrt(2)) (Green and Swets, 1966)."""
    return ndtr(np.asarray(d_prime, dtype=float) / np.sqrt(2.0))


def two_interval(
    base_N: ArrayLike, step_N: ArrayLike, weber: ArrayLike, offset_N: ArrayLike, lapse: ArrayLike = 0.0
) -> Array:
    """Share of right answers to which of two forces was greater, `base_N` or `base_N + step_N`.

    The distance d' grows with the step and is 0.954 (75 %) at the threshold weber (base + offset), which is Weber's law
    with its term for low forces. Arguments broadcast.

    Parameters
    ----------
    base_N, step_N
        The smaller force, and how much greater the other is [N], at least 0.
    weber
        Weber fraction, positive.
    offset_N
        Force that Weber's law is short of at low forces [N].
    lapse
        Share of strong stimuli that is answered wrongly.
    """
    threshold = np.asarray(weber) * (np.asarray(base_N) + np.asarray(offset_N))
    return with_lapse(2.0 * correct_of_d_prime(D_PRIME_75 * np.asarray(step_N) / threshold) - 1.0, lapse)
