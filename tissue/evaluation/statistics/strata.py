"""F tests of a design with groups of users and factors within users, for one or more metrics."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import helmert
from scipy.stats import f

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import HypothesisTest

__all__ = [
    "Pillai",
    "Strata",
    "effect_scores",
    "group_means",
    "multivariate",
    "pillai",
    "scores_of",
    "strata",
]


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
        Measure of sphericity by Greenhouse and Geisser (1959), and p value with the degrees of
        freedom multiplied by this measure. The measure is 1 if the contrasts are spherical.
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


def effect_scores(
    values: Array,
    sizes: tuple[int, ...],
    chosen: tuple[int, ...],
    *,
    contrasts: Callable[[int], Array],
    mean_weight: Callable[[int], float],
) -> Array:
    """Compute the scores of every user: contrasts of the levels of an effect within users.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels). The last axis has all combinations of the levels of
        the factors; the last factor changes fastest.
    sizes
        Number of levels of each factor.
    chosen
        Indices of the factors in the effect.
    contrasts
        Function that returns the weights of contrasts, shape (contrasts, levels), for a number of
        levels. It is applied to the factors in the effect.
    mean_weight
        Function that returns the equal weight of each level, for a number of levels. It is applied
        to the factors outside the effect.

    Returns
    -------
    Array
        Scores, shape (..., users, contrasts).
    """
    parts = [
        contrasts(size) if index in chosen else np.full((1, size), mean_weight(size))
        for index, size in enumerate(sizes)
    ]
    return values @ reduce(np.kron, parts).T


def scores_of(values: Array, sizes: tuple[int, ...], chosen: tuple[int, ...]) -> Array:
    """Compute the scores of every user on orthonormal contrasts of an effect within users.

    Parameters and shapes are those of :func:`effect_scores`. Without chosen factors, the score is
    the mean of the user multiplied by the square root of the number of levels.
    """
    return effect_scores(
        values,
        sizes,
        chosen,
        contrasts=helmert,
        # of unit length, as the contrasts
        mean_weight=lambda size: size**-0.5,
    )


def strata(
    values: Array,
    groups: Ints,
    sizes: tuple[int, ...],
    chosen: tuple[int, ...] = (),
    *,
    between: bool,
) -> Strata:
    """Test one effect by an F test against the variation of its scores between users.

    This variation is the error term (stratum) of the effect, and includes interactions of users
    with methods. A mixed model approximates this test. The test is exact in a balanced design with
    normal effects of users, of users by factor and of trials.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels).
    groups
        Group of every user, 0 to G - 1, shape (users,). There must be more users than groups.
    sizes
        Number of levels of each factor within users.
    chosen
        Indices of the factors within users that belong to the effect. At least one, unless
        `between` is true.
    between
        If true, the effect of the group is tested if `chosen` is empty, otherwise the interaction
        of the group with the chosen factors. If false, the effect of the chosen factors, as the
        mean over groups with equal weights, is tested against zero.
    """
    scores = scores_of(values, sizes, chosen)
    contrasts = scores.shape[-1]
    counts = np.bincount(groups)
    group_count = len(counts)
    user_count = len(groups)
    means = group_means(scores, groups)
    residuals = scores - means[..., groups, :]
    products = np.swapaxes(residuals, -1, -2) @ residuals / (user_count - group_count)
    error = np.trace(products, axis1=-2, axis2=-1) / contrasts
    if between:
        overall = (counts @ means / user_count)[..., None, :]
        squares = ((means - overall) ** 2).sum(axis=-1) @ counts
        above = contrasts * (group_count - 1)
    else:
        # the mean over groups of equal weight has the variance of sum(1 / n) / G**2
        squares = (means.mean(axis=-2) ** 2).sum(axis=-1) * group_count**2 / (1.0 / counts).sum()
        above = contrasts
    below = contrasts * (user_count - group_count)
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = squares / above / error
        epsilon = (error * contrasts) ** 2 / (contrasts * (products**2).sum(axis=(-2, -1)))
    return Strata(
        statistic,
        f.sf(statistic, above, below),
        error,
        (above, below),
        epsilon,
        f.sf(statistic, epsilon * above, epsilon * below),
    )


@dataclass(frozen=True)
class Pillai:
    """Pillai's trace and its F test, for one or more populations.

    Attributes
    ----------
    trace, F, p
        Trace, F statistic and p value of F, one for each population.
    degrees
        Degrees of freedom of F.
    """

    trace: Array
    F: Array
    p: Array
    degrees: tuple[float, float]


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
    counts = np.bincount(groups)
    means = group_means(scores, groups)
    residuals = scores - means[..., groups, :]
    error = np.swapaxes(residuals, -1, -2) @ residuals
    if between:
        apart = (means - (counts @ means / counts.sum())[..., None, :]) * np.sqrt(counts)[:, None]
        effect = np.swapaxes(apart, -1, -2) @ apart
        above = len(counts) - 1
    else:
        middle = means.mean(axis=-2)
        effect = (
            middle[..., :, None] * middle[..., None, :] * len(counts) ** 2 / (1.0 / counts).sum()
        )
        above = 1
    trace = np.trace(np.linalg.solve(effect + error, effect), axis1=-2, axis2=-1)
    below = groups.size - len(counts)
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
            "be more than groups and columns together, with two groups or methods to compare",
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
            question,
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
