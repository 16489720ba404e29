"""Tests by sign flips. The decisions of a study follow from these tests.

The tests compare all pairs of levels or groups by t statistics, each with its own standard error.
Unlike F tests and permutation tests, tests by sign flips are valid for methods and groups that
differ in spread.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.evaluation.statistics.hypothesis_test import ALPHA
from tissue.evaluation.statistics.strata import effect_scores, group_means

__all__ = [
    "SignTest",
    "largest_squared_t",
    "pair_differences",
    "pair_scores",
    "sign_test",
    "sign_test_p",
]

FLIPS = 19_999
"""Number of sign flips of a test.

A whole study has 54 planned tests, and each decides at p = 0.0009. A p of this size has a standard
error of 0.0002.
"""
FLIPS_OF_RATES = 199
"""Number of sign flips of a test that is repeated on thousands of data sets.

With 199 flips, a level of 5 % is exact.
"""
BLOCK = 2_000_000
"""Number of values that are in memory at once, 16 MB."""
SMALLEST = 1e-12
"""Lower bound of a variance relative to the mean square, above the rounding error of both."""
EQUAL = 1e-9
"""Relative difference below which two statistics count as equal.

The rounding error is 1e-16 of the mean square. A small variance magnifies the rounding error.
"""


@dataclass(frozen=True)
class SignTest:
    """Result of a test by sign flips.

    Attributes
    ----------
    statistic, p
        Largest absolute t over all pairs, and the share of flips whose largest t is at least as
        large.
    differences, errors
        Mean difference of each pair with its standard error, shape (pairs,).
    pair_p
        Share of flips whose largest t reaches the pair's t, shape (pairs,). These p values hold for
        all pairs together (Westfall and Young 1993).
    critical
        Absolute t that is reached with a probability of 5 %. ``differences ± critical * errors``
        are simultaneous 95 % intervals.
    """

    statistic: float
    p: float
    differences: Array
    errors: Array
    pair_p: Array
    critical: float


def pair_differences(count: int) -> Array:
    """Return the weights of all pairs of levels, later minus earlier, shape (pairs, count)."""
    pairs = list(combinations(range(count), 2))
    weights = np.zeros((len(pairs), count))
    for row, (first, second) in enumerate(pairs):
        weights[row, first] = -1.0
        weights[row, second] = 1.0
    return weights


def pair_scores(values: Array, sizes: tuple[int, ...], chosen: tuple[int, ...]) -> Array:
    """Compute the differences of every user between all pairs of levels of one effect.

    Parameters and shapes are those of :func:`effect_scores`. An interaction gives differences of
    differences. Without chosen factors, the score is a user's mean.
    """
    return effect_scores(
        values,
        sizes,
        chosen,
        contrasts=pair_differences,
        mean_weight=lambda size: 1.0 / size,
    )


def _compared(means: Array, variances: Array, *, between: bool) -> tuple[Array, Array]:
    """Return the differences to be tested and their variances, each of shape (..., pairs).

    Parameters
    ----------
    means, variances
        Mean of the users of each group and its variance, shape (..., groups, scores).
    between
        Compare groups; if not, take the mean over groups of equal weight.
    """
    count = means.shape[-2]
    if not between:
        return means.mean(axis=-2), variances.mean(axis=-2) / count
    pairs = pair_differences(count)
    shape = (*means.shape[:-2], -1)
    return (pairs @ means).reshape(shape), (np.abs(pairs) @ variances).reshape(shape)


def largest_squared_t(means: Array, variances: Array, *, between: bool) -> Array:
    """Return the largest squared t over all pairs, shape (...).

    Parameters
    ----------
    means, variances
        Mean of the users of each group and its variance, shape (..., groups, scores).
    between
        Compare groups; if not, test the mean over groups of equal weight against zero.
    """
    differences, squared_errors = _compared(means, variances, between=between)
    return (differences**2 / squared_errors).max(axis=-1)


def _moments(scores: Array, groups: Ints, signs: Array) -> tuple[Array, Array]:
    """Return the means of groups after sign flips, and the variances of these means.

    Parameters
    ----------
    scores
        Shape (..., users, scores).
    groups
        Group of every user, shape (users,), two users or more each.
    signs
        Shape (flips, users).

    Returns
    -------
    tuple of Array
        Both of shape (..., flips, groups, scores).
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
    """Return the values whose signs are flipped: the scores, or the residuals about group means.

    Residuals are used if groups are compared.
    """
    if between:
        return scores - group_means(scores, groups)[..., groups, :]
    return scores


def _signs(count: int, users: int, rng: np.random.Generator) -> Array:
    """Return random signs, shape (count, users)."""
    return np.where(rng.integers(2, size=(count, users)) == 1, 1.0, -1.0)


def flipped_p(measured: Array, flipped: Array) -> Array:
    """Return the share of flipped statistics that reach the measured statistic (Edgington 1995).

    Parameters
    ----------
    measured
        Shape (...).
    flipped
        Statistics after sign flips, shape (..., flips). The measured statistic counts as one more
        flip.
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
    """Test differences within users, or between groups, by sign flips of whole users.

    The statistic is the largest absolute t over all pairs. Each t has its own standard error, from
    the variance within each group (Welch 1938).

    Without an effect, and with symmetric errors, the differences of a user are equally likely with
    the opposite sign. Flips of all scores of a user at once then give an exact test within users,
    whatever the spreads and correlations of the methods. Groups are compared by flips of the
    residuals about their means (Wu 1986; Liu 1988, the wild bootstrap), which is exact only in
    large groups.

    Parameters
    ----------
    scores
        Scores of :func:`pair_scores`, shape (users, scores). Scores of several metrics may be
        joined.
    groups
        Group of every user, 0 to G - 1, shape (users,), two users or more each.
    between
        Compare groups; if not, test the mean of the scores over groups of equal weight against
        zero.
    rng
        Generator of the signs.
    flips
        Number of flips.
    """
    ones = np.ones((1, len(groups)))
    means, variances = _moments(scores, groups, ones)
    differences, squared_errors = _compared(means[0], variances[0], between=between)
    squares = differences**2 / squared_errors
    held = _flipped(scores, groups, between=between)
    block = max(1, BLOCK // (len(squares) * (groups.max() + 1)))
    largest = []
    for start in range(0, flips, block):
        signs = _signs(min(block, flips - start), len(groups), rng)
        largest.append(largest_squared_t(*_moments(held, groups, signs), between=between))
    flipped = np.concatenate(largest)
    ordered = np.sort(flipped)
    # the flips that reach it and the measured statistic are 5 % of all
    critical = ordered[-max(1, int(ALPHA * (flips + 1)))] ** 0.5
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
    """Return the p values of :func:`sign_test` over many data sets.

    Parameters
    ----------
    scores
        Shape (data sets, users, scores).
    groups, between, rng, flips
        As in :func:`sign_test`. Signs are drawn once for a block of data sets, not for each data
        set.

    Returns
    -------
    Array
        Shape (data sets,).
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
