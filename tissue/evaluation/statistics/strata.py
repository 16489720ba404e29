"""Exact tests of a design with groups of users and factors within users, many populations at once."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import helmert
from scipy.stats import chi2, f

from meshes.base.arrays import Array, Ints

__all__ = ["Strata", "group_means", "mauchly", "scores_of", "strata"]


@dataclass(frozen=True)
class Strata:
    """F tests over populations.

    Attributes
    ----------
    F, p
        Statistic and its chance where there is no effect, shape of the populations.
    error_square
        Mean square below the bar.
    degrees
        Degrees of freedom of both.
    epsilon, corrected_p
        Greenhouse and Geisser's (1959) measure of sphericity, 1 where it holds, and p with degrees scaled by it.
    """

    F: Array
    p: Array
    error_square: Array
    degrees: tuple[int, int]
    epsilon: Array
    corrected_p: Array


def group_means(values: Array, groups: Ints) -> Array:
    """Mean of each group over its users, shape (..., groups, columns), of values of shape (..., users, columns)."""
    member = np.equal.outer(np.arange(groups.max() + 1), groups).astype(float)
    return (member / member.sum(axis=1, keepdims=True)) @ values


def scores_of(values: Array, sizes: tuple[int, ...], chosen: tuple[int, ...]) -> Array:
    """Scores of every user on orthonormal contrasts of one effect within users.

    Parameters
    ----------
    values
        Cell means, shape (..., users, levels), levels the product of `sizes`, the last factor fastest.
    sizes
        Levels of each factor.
    chosen
        Factors in the effect; none for a user's mean (times the root of the number of levels).

    Returns
    -------
    Array
        Shape (..., users, contrasts).
    """
    parts = [helmert(size) if index in chosen else np.full((1, size), size**-0.5) for index, size in enumerate(sizes)]
    return values @ reduce(np.kron, parts).T


def strata(
    values: Array, groups: Ints, sizes: tuple[int, ...], chosen: tuple[int, ...] = (), *, between: bool
) -> Strata:
    """Test one effect against the variation between users that it is exposed to.

    In a balanced design with normal effects of users, of users by factor and of trials these are the exact tests that a
    mixed model approximates; users who differ in how they take the methods are allowed for.

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
        Whether the effect involves the group: alone where `chosen` is empty, else how the effect differs with it. If
        not, the mean of the effect over groups of equal weight is tested against zero.
    """
    scores = scores_of(values, sizes, chosen)
    contrasts = scores.shape[-1]
    counts = np.bincount(groups)
    group_count, user_count = len(counts), len(groups)
    means = group_means(scores, groups)
    residuals = scores - means[..., groups, :]
    products = np.swapaxes(residuals, -1, -2) @ residuals / (user_count - group_count)
    error = np.trace(products, axis1=-2, axis2=-1) / contrasts
    if between:
        overall = (counts @ means / user_count)[..., None, :]
        squares = ((means - overall) ** 2).sum(axis=-1) @ counts
        above = contrasts * (group_count - 1)
    else:
        squares = (means.mean(axis=-2) ** 2).sum(axis=-1) * group_count**2 / (1.0 / counts).sum()
        above = contrasts
    below = contrasts * (user_count - group_count)
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = squares / above / error
        epsilon = (error * contrasts) ** 2 / (contrasts * (products**2).sum(axis=(-2, -1)))
    return Strata(
        np.asarray(statistic),
        np.asarray(f.sf(statistic, above, below)),
        np.asarray(error),
        (above, below),
        np.asarray(epsilon),
        np.asarray(f.sf(statistic, epsilon * above, epsilon * below)),
    )


def mauchly(scores: Array, groups: Ints) -> float:
    """Chance of so uneven a covariance of contrasts under sphericity (Mauchly 1940), 1 for one contrast.

    Parameters
    ----------
    scores
        Scores of users on orthonormal contrasts, shape (users, contrasts).
    groups
        Group of every user, shape (users,).
    """
    count = scores.shape[-1]
    if count == 1:
        return 1.0
    residuals = scores - group_means(scores, groups)[groups]
    degrees = len(scores) - groups.max() - 1
    if degrees <= count:
        return float("nan")
    spread = residuals.T @ residuals / degrees
    log_w = np.linalg.slogdet(spread)[1] - count * np.log(np.trace(spread) / count)
    scale = degrees - (2.0 * count * count + count + 2.0) / (6.0 * count)
    return float(chi2.sf(-scale * log_w, count * (count + 1) / 2 - 1))
