"""F tests of a design with groups of users and factors within users, for one or more metrics."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.linalg import helmert
from scipy.stats import f

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import HypothesisTest


@dataclass(frozen=True)
class Strata:
    """F tests of one effect.

    The values may come from several populations. Arrays then have one entry per population.

    Attributes
    ----------
    F, p
        F statistic and p value, one for each population.
    error_square
        Mean square of the error, which is the denominator of F.
    degrees
        Degrees of freedom of numerator and denominator.
    epsilon, corrected_p
        Measure of sphericity by Greenhouse and Geisser (1959), which is 1 for spherical contrasts.
        The corrected p value uses degrees of freedom that are multiplied by this measure.
    """

    F: Array
    p: Array
    error_square: Array
    degrees: tuple[int, int]
    epsilon: Array
    corrected_p: Array


def group_means(values: Array, groups: Ints) -> Array:
    """Return the mean of each group over its users, shape (..., groups, columns).

    The values have shape (..., users, columns).
    """
    member = np.equal.outer(np.arange(groups.max() + 1), groups).astype(float)
    return (member / member.sum(axis=1, keepdims=True)) @ values


def pair_differences(count: int) -> Array:
    """Return the weights of the differences between all pairs of levels, shape (pairs, count).

    In each pair, the earlier level is subtracted from the later level.
    """
    first, second = np.array(list(combinations(range(count), 2)), dtype=int).reshape(-1, 2).T
    unit = np.eye(count)
    return unit[second] - unit[first]


def effect_scores(
    values: Array,
    sizes: tuple[int, ...],
    chosen: tuple[int, ...],
    contrasts: Callable[[int], Array] = helmert,
    power: float = -0.5,
) -> Array:
    """Compute the scores of every user: contrasts between the levels of an effect.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels). The last axis has all combinations of the levels of
        the factors; the last factor changes fastest.
    sizes
        Number of levels of each factor.
    chosen
        Indices of the factors in the effect. If empty, the score is proportional to the mean of the
        user.
    contrasts
        Function that returns the weights of contrasts, shape (contrasts, levels), for a number of
        levels. It is applied to the factors in the effect. Default: orthonormal contrasts.
    power
        Exponent p: the levels of each factor outside the effect are summed with the weight n^p,
        where n is the number of levels. -1 gives the mean. The default gives a weight vector of
        unit length.

    Returns
    -------
    Array
        Scores, shape (..., users, contrasts).
    """
    parts = [
        contrasts(size) if index in chosen else np.full((1, size), size**power)
        for index, size in enumerate(sizes)
    ]
    return values @ reduce(np.kron, parts).T


def _squares(scores: Array, groups: Ints, *, between: bool) -> tuple[Array, Array, int, int]:
    """Return sums of squares and products of an effect and its error, and degrees of freedom.

    Scores have shape (..., users, columns). The sums have shape (..., columns, columns). If
    `between` is true, the effect is the difference of groups. Otherwise, the effect is the mean
    over groups with equal weights.
    """
    counts = np.bincount(groups)
    means = group_means(scores, groups)
    residuals = scores - means[..., groups, :]
    if between:
        overall = (counts @ means / len(groups))[..., None, :]
        shifts = (means - overall) * np.sqrt(counts)[:, None]
        above = len(counts) - 1
    else:
        # the mean over groups of equal weight has the variance of sum(1 / n) / G**2
        shifts = means.mean(axis=-2, keepdims=True) * len(counts) / np.sqrt((1.0 / counts).sum())
        above = 1
    effect, error = (np.swapaxes(each, -1, -2) @ each for each in (shifts, residuals))
    return effect, error, above, len(groups) - len(counts)


def strata(
    values: Array,
    groups: Ints,
    sizes: tuple[int, ...],
    chosen: tuple[int, ...] = (),
    *,
    between: bool,
) -> Strata:
    """Test one effect by an F test; the error is the variation of its scores between users.

    This variation is the error term (stratum) of the effect, and includes interactions of users
    with methods. The p value is exact for a balanced design with normally distributed random
    effects.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels).
    groups
        Group of every user, 0 to G - 1, shape (users,). There must be more users than groups.
    sizes
        Number of levels of each factor within users.
    chosen
        Indices of the factors within users that belong to the effect. At least one index is needed,
        unless `between` is true.
    between
        If true, test the effect of the group or, if `chosen` is not empty, the interaction of the
        group with the chosen factors. If false, test against zero the effect of the chosen factors,
        averaged over groups with equal weights.
    """
    scores = effect_scores(values, sizes, chosen)
    effect, error, above, below = _squares(scores, groups, between=between)
    columns = scores.shape[-1]
    degrees = (columns * above, columns * below)
    left = np.trace(error, axis1=-2, axis2=-1)
    square = left / degrees[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = np.trace(effect, axis1=-2, axis2=-1) / degrees[0] / square
        epsilon = left**2 / (columns * (error**2).sum(axis=(-2, -1)))
    corrected = f.sf(statistic, epsilon * degrees[0], epsilon * degrees[1])
    return Strata(statistic, f.sf(statistic, *degrees), square, degrees, epsilon, corrected)


def tukey(values: Array, groups: Ints, *, between: bool) -> tuple[Array, Array, tuple[int, int]]:
    """Return the data for Tukey's test: differences of all pairs, errors, degrees of freedom.

    Parameters
    ----------
    values
        Means of users, shape (..., users, levels).
    groups
        Group of every user, shape (users,).
    between
        If true, compare groups (Tukey and Kramer). If false, compare levels within users. The
        error is then the interaction of users with levels, without the effects of the groups.

    Returns
    -------
    tuple
        Differences and standard errors, each of shape (..., pairs), then the pair (number of
        compared means, degrees of freedom of the error). A difference divided by its standard error
        is a studentised range.
    """
    counts = np.bincount(groups)
    means = group_means(values, groups)
    if between:
        means = means.mean(axis=-1)
        found = strata(values, groups, values.shape[-1:], between=True)
        # of the mean of a user, whose score is larger by the root of the number of levels
        square = found.error_square / values.shape[-1]
        weights = 0.5 * np.abs(pair_differences(len(counts))) @ (1.0 / counts)
    else:
        means = means.mean(axis=-2)
        found = strata(values, groups, values.shape[-1:], (0,), between=False)
        square = found.error_square
        weights = (1.0 / counts).sum(keepdims=True) / len(counts) ** 2
    pairs = pair_differences(means.shape[-1])
    errors = np.sqrt(np.multiply.outer(square, weights))
    differences = means @ pairs.T
    return differences, errors + 0.0 * differences, (len(pairs.T), found.degrees[1])


class Pillai(NamedTuple):
    """Pillai's trace and its F test, for one or more populations."""

    trace: Array
    F: Array
    p: Array
    degrees: tuple[float, float]
    """Degrees of freedom of F."""


def pillai(scores: Array, groups: Ints, *, between: bool) -> Pillai:
    """Compute Pillai's trace and its F test, for one or more populations (Pillai 1955).

    Parameters
    ----------
    scores
        Scores of users on contrasts of all metrics, shape (..., users, columns).
    groups
        Group of every user, shape (users,).
    between
        If true, compare groups. If false, test the mean over groups (with equal weights) against
        zero.
    """
    effect, error, above, below = _squares(scores, groups, between=between)
    trace = np.trace(np.linalg.solve(effect + error, effect), axis1=-2, axis2=-1)
    width = scores.shape[-1]
    rank = min(width, above)
    degrees = (rank * (abs(width - above) + rank), rank * (below - width + rank))
    statistic = trace / degrees[0] / ((rank - trace) / degrees[1])
    return Pillai(trace, statistic, f.sf(statistic, *degrees), degrees)


def multivariate(
    scores: Array,
    groups: Ints,
    *,
    between: bool,
    question: str,
) -> HypothesisTest:
    """Run a multivariate analysis of variance.

    Parameters
    ----------
    scores
        Scores of users on contrasts of all metrics, shape (users, columns).
    groups
        Group of every user, 0 to G - 1, shape (users,).
    between
        If true, compare groups. If false, test the mean of the columns over groups (with equal
        weights) against zero.
    question
        Question of the test, for the returned result.

    Returns
    -------
    HypothesisTest
        F test of Pillai's trace, the most robust of the four multivariate statistics (Olson 1974).

    Raises
    ------
    InputError
        If there are too few users for the number of columns, or one column is a linear combination
        of others.
    """
    counts = np.bincount(groups)
    width = scores.shape[1]
    if not width or len(scores) - len(counts) <= width or (between and len(counts) < 2):
        raise InputError(
            "users",
            "outnumber the groups and columns together, with two groups or methods to compare",
            f"{len(scores)} users, {len(counts)} groups and {width} columns",
            "add users or drop metrics",
        )
    scaled = scores / scores.std(axis=0)
    residuals = scaled - group_means(scaled, groups)[groups]
    # rounding of standardised columns, whose singular values grow with the number of rows
    if np.linalg.matrix_rank(residuals, tol=1e-8 * len(scores)) < width:
        raise InputError(
            "columns",
            "not be multiples of one another",
            f"dependent columns in the test of {question}",
            "leave out a metric that repeats another one",
        )
    found = pillai(scaled, groups, between=between)
    return HypothesisTest(
        f"MANOVA, Pillai's trace {float(found.trace):.4g}",
        question,
        "F",
        float(found.F),
        found.degrees,
        float(found.p),
    )
