"""Sign-flip tests: permutation tests that change the signs of differences.

The conclusions of a study are drawn from these tests.

The tests compare all pairs of levels or groups by t statistics, each with its own standard error.
Unlike F tests and permutations of labels, sign flips are valid for methods and groups with
different variances.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.evaluation.statistics.hypothesis_test import ALPHA
from tissue.evaluation.statistics.strata import effect_scores, group_means, pair_differences

FLIPS = 19_999
"""Number of random sign flips of a test.

A complete study has 54 planned tests, so the critical p value is 5 % / 54 = 0.0009. With this
number of flips, a p value of this size has a standard error of 0.0002.
"""
FLIPS_OF_RATES = 199
"""Number of random sign flips of a test that is repeated on thousands of data sets.

With 199 flips, a significance level of 5 % is met exactly.
"""
LARGEST_T = 1e5
"""Absolute t above which the variance of a flip counts as zero.

The lower bound `SMALLEST` of the variance limits t to 1e6.
"""
BLOCK = 2_000_000
"""Largest number of array entries that are processed at once (16 MB)."""
SMALLEST = 1e-12
"""Lower bound of a variance relative to the mean square, above the rounding error."""
EQUAL = 1e-9
"""Relative difference below which two statistics count as equal.

In a statistic with a small variance, the relative rounding error is larger than 1e-16.
"""


@dataclass(frozen=True)
class SignTest:
    """Result of a test by sign flips.

    Attributes
    ----------
    statistic, p
        Largest absolute t over all pairs, and its p value: the fraction of sign flips whose largest
        t is at least as large.
    differences, errors
        Mean difference of each pair, and its standard error, each of shape (pairs,).
    pair_p
        p value of each pair, shape (pairs,): the fraction of flips whose largest t over all pairs
        is at least the t of this pair. These p values are corrected for the comparison of all pairs
        (Westfall and Young 1993).
    critical
        95 % quantile of the largest absolute t after random sign flips. ``differences ± critical *
        errors`` are simultaneous 95 % intervals. Infinite if the users are too few for such an
        interval.
    """

    statistic: float
    p: float
    differences: Array
    errors: Array
    pair_p: Array
    critical: float


def pair_scores(values: Array, sizes: tuple[int, ...], chosen: tuple[int, ...]) -> Array:
    """Compute each user's differences between all pairs of levels of an effect.

    See :func:`effect_scores` for parameters and shapes. For an interaction, the scores are
    differences of differences. If `chosen` is empty, the score is the mean of the user.
    """
    return effect_scores(values, sizes, chosen, pair_differences, -1.0)


def _compared(means: Array, variances: Array, *, between: bool) -> tuple[Array, Array]:
    """Return the differences to test and their variances, each of shape (..., pairs).

    Parameters
    ----------
    means, variances
        Mean over the users of each group, and variance of this mean, each of shape (..., groups,
        scores).
    between
        If true, compare groups. If false, return the mean over groups, with equal weights.
    """
    count = means.shape[-2]
    if not between:
        return means.mean(axis=-2), variances.mean(axis=-2) / count
    pairs = pair_differences(count)
    shape = (*means.shape[:-2], -1)
    return (pairs @ means).reshape(shape), (np.abs(pairs) @ variances).reshape(shape)


def largest_squared_t(means: Array, variances: Array, *, between: bool) -> Array:
    """Return the largest squared t statistic over all pairs, shape (...).

    Parameters
    ----------
    means, variances
        Mean over the users of each group, and variance of this mean, each of shape (..., groups,
        scores).
    between
        If true, compare groups. If false, test the mean over groups (with equal weights) against
        zero.
    """
    differences, squared_errors = _compared(means, variances, between=between)
    return (differences**2 / squared_errors).max(axis=-1)


def _moments(scores: Array, groups: Ints, signs: Array) -> tuple[Array, Array]:
    """Return the group means of scores after sign flips, and the variances of the means.

    Parameters
    ----------
    scores
        Shape (..., users, scores).
    groups
        Group of every user, shape (users,). Each group has at least two users.
    signs
        Signs, 1 or -1, shape (flips, users).

    Returns
    -------
    tuple of Array
        Means and variances, each of shape (..., flips, groups, scores).
    """
    means = []
    variances = []
    for group in range(groups.max() + 1):
        members = groups == group
        held = scores[..., members, :]
        count = held.shape[-2]
        mean = signs[:, members] @ held / count
        square = (held**2).mean(axis=-2)[..., None, :]
        # a constant zero has neither a mean nor a variance, and t = 0
        bound = np.maximum(SMALLEST * square, np.finfo(float).tiny)
        means.append(mean)
        variances.append(np.maximum(square - mean**2, bound) / (count - 1))
    return np.stack(means, axis=-2), np.stack(variances, axis=-2)


def _flipped(scores: Array, groups: Ints, *, between: bool) -> Array:
    """Return the values to flip: scores or, if groups are compared, scores minus group means.

    The shape is that of `scores`.
    """
    if between:
        return scores - group_means(scores, groups)[..., groups, :]
    return scores


def _signs(count: int, users: int, rng: np.random.Generator) -> Array:
    """Return random signs, 1 or -1, shape (count, users)."""
    return np.where(rng.integers(2, size=(count, users)) == 1, 1.0, -1.0)


def _all_signs(users: int) -> Array:
    """Return all combinations of signs except those without a flip, shape (2^users - 1, users)."""
    patterns = np.arange(1, 2**users)[:, None] >> np.arange(users)
    return np.where(patterns & 1, -1.0, 1.0)


def flipped_p(measured: Array, flipped: Array) -> Array:
    """Return the p value: the share of flips with at least the measured statistic (Edgington 1995).

    Parameters
    ----------
    measured
        Measured statistics, shape (...).
    flipped
        Statistics after sign flips, shape (..., flips). The measured statistic counts as an
        additional flip.
    """
    reached = (flipped >= measured[..., None] * (1.0 - EQUAL)).sum(axis=-1)
    return (1.0 + reached) / (flipped.shape[-1] + 1.0)


def sign_test(
    scores: Array,
    groups: Ints,
    *,
    between: bool,
    rng: np.random.Generator,
    flips: int = FLIPS,
) -> SignTest:
    """Test differences within users, or between groups, by sign flips.

    A flip changes the signs of all scores of a user together.

    The statistic is the largest absolute t over all pairs. Each t has its own standard error,
    computed from the variances within the groups (Welch 1938).

    If there is no effect and the errors are symmetric, a user's differences are as likely as the
    same differences with opposite signs. The test within users then has exactly the nominal error
    rate, whatever the variances and correlations of the methods. For the comparison of groups, the
    deviations of the scores from their group means are flipped in sign (wild bootstrap, Wu 1986;
    Liu 1988). The error rate of this test is exact only in the limit of large groups.

    Parameters
    ----------
    scores
        Scores by :func:`pair_scores`, shape (users, scores). Scores of several metrics may be
        joined along the second axis.
    groups
        Group of every user, 0 to G - 1, shape (users,). Each group has at least two users.
    between
        If true, compare groups. If false, test the mean of the scores over groups (with equal
        weights) against zero.
    rng
        Random generator of the signs.
    flips
        Number of random sign flips. If there are at most `flips` sign combinations besides the
        original one, each is used once, and the p value is exact.
    """
    users = len(groups)
    every = _all_signs(users) if 2**users - 1 <= flips else None
    if every is not None:
        flips = len(every)
    ones = np.ones((1, users))
    means, variances = _moments(scores, groups, ones)
    differences, squared_errors = _compared(means[0], variances[0], between=between)
    squares = differences**2 / squared_errors
    held = _flipped(scores, groups, between=between)
    block = max(1, BLOCK // (len(squares) * (groups.max() + 1)))
    largest = []
    for start in range(0, flips, block):
        if every is None:
            signs = _signs(min(block, flips - start), users, rng)
        else:
            signs = every[start : start + block]
        largest.append(largest_squared_t(*_moments(held, groups, signs), between=between))
    flipped = np.concatenate(largest)
    ordered = np.sort(flipped)
    # the flips that reach it and the measured statistic are 5 % of all
    rank = int(ALPHA * (flips + 1))
    # within users, the flip of all signs has the measured statistic, too
    critical = inf if rank < (1 if between else 2) else float(ordered[-rank] ** 0.5)
    if critical > LARGEST_T:
        critical = inf
    pair_p = flipped_p(squares, np.broadcast_to(flipped, (len(squares), flips)))
    return SignTest(
        squares.max() ** 0.5,
        pair_p.min(),
        differences,
        np.sqrt(squared_errors),
        pair_p,
        critical,
    )


def sign_test_p(
    scores: Array,
    groups: Ints,
    *,
    between: bool,
    rng: np.random.Generator,
    flips: int = FLIPS_OF_RATES,
) -> Array:
    """Return the p value of :func:`sign_test` for each of many data sets.

    Parameters
    ----------
    scores
        Scores by :func:`pair_scores`, shape (data sets, users, scores).
    groups, between, rng, flips
        As in :func:`sign_test`. All data sets in a block use the same random signs.

    Returns
    -------
    Array
        p values, shape (data sets,).
    """
    ones = np.ones((1, len(groups)))
    held = _flipped(scores, groups, between=between)
    widest = scores.shape[-1] * (groups.max() + 1) * flips
    block = max(1, BLOCK // widest)
    found = []
    for start in range(0, len(scores), block):
        chosen = slice(start, start + block)
        measured = largest_squared_t(*_moments(scores[chosen], groups, ones), between=between)
        signs = _signs(flips, len(groups), rng)
        flipped = largest_squared_t(*_moments(held[chosen], groups, signs), between=between)
        found.append(flipped_p(measured[..., 0], flipped))
    return np.concatenate(found)
