"""F tests of a design with groups of users and factors within users, for one metric or several."""

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
    """F tests over populations.

    Attributes
    ----------
    F, p
        F statistic and its p value, with the shape of the populations.
    error_square
        Mean square in the denominator of F.
    degrees
        Degrees of freedom of numerator and denominator.
    epsilon, corrected_p
        Greenhouse and Geisser's (1959) measure of sphericity, and p with the degrees of freedom
        multiplied by this measure. The measure is 1 if sphericity holds.
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
    """Compute the scores of every user on contrasts of one effect within users.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels). The number of levels is the product of `sizes`, with
        the last factor fastest.
    sizes
        Levels of each factor.
    chosen
        Factors in the effect.
    contrasts
        Function from the number of levels of a factor in the effect to the weights of its
        contrasts, shape (contrasts, levels).
    mean_weight
        Function from the number of levels of a factor outside the effect to the weight of each
        level.

    Returns
    -------
    Array
        Shape (..., users, contrasts).
    """
    parts = [
        contrasts(size) if index in chosen else np.full((1, size), mean_weight(size))
        for index, size in enumerate(sizes)
    ]
    return values @ reduce(np.kron, parts).T


def scores_of(values: Array, sizes: tuple[int, ...], chosen: tuple[int, ...]) -> Array:
    """Compute the scores of every user on orthonormal contrasts of one effect within users.

    Parameters and shapes are those of :func:`effect_scores`. Without chosen factors, the score is
    a user's mean multiplied by the square root of the number of levels.
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
    """Test one effect against the variation between users in its stratum.

    In a balanced design with normal effects of users, of users by factor and of trials, these are
    the exact tests that a mixed model approximates. The variation includes interactions of users
    with methods.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels).
    groups
        Group of every user, 0 to G - 1, shape (users,); users outnumber groups.
    sizes
        Levels of each factor within users.
    chosen
        Factors within users that are in the effect; at least one unless `between`.
    between
        True if the effect involves the group: the group alone if `chosen` is empty, otherwise the
        interaction of the effect with the group. If false, the mean of the effect over groups of
        equal weight is tested against zero.
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
    """Pillai's trace over populations, and its F test.

    Attributes
    ----------
    trace, F, p
        Trace, F statistic and its p value, with the shape of the populations.
    degrees
        Degrees of freedom of F.
    """

    trace: Array
    F: Array
    p: Array
    degrees: tuple[float, float]


def pillai(scores: Array, groups: Ints, *, between: bool) -> Pillai:
    """Compute Pillai's trace and its F test over many populations (Pillai 1955).

    Parameters
    ----------
    scores
        Shape (..., users, columns).
    groups
        Group of every user, shape (users,).
    between
        Compare groups; if not, test the mean over groups of equal weight against zero.
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
        One row per user, shape (users, columns).
    groups
        Group of every user, 0 to G - 1, shape (users,).
    between
        Compare groups; if not, test the mean of the columns over groups of equal weight against
        zero.
    question
        Question of the test, for the sentence.

    Returns
    -------
    HypothesisTest
        Pillai's trace, the most robust of the four statistics (Olson 1974).

    Raises
    ------
    InputError
        If there are too few users for the columns, or one column is a multiple of another.
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
