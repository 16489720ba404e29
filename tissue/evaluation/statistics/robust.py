"""Tests that rest on less: no equal variances, no normality, no sphericity."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f, friedmanchisquare, kruskal

from meshes.base.errors import InputError
from tissue.evaluation.statistics.outcome import Outcome
from tissue.evaluation.statistics.strata import scores_of, strata

__all__ = ["friedman", "hotelling", "kruskal_wallis", "permutation", "welch"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def welch(values: Array, groups: Ints, *, question: str) -> Outcome:
    """Compare means of groups of unequal variance (Welch 1951).

    Parameters
    ----------
    values
        One value a user, shape (users,).
    groups
        Group of every user, 0 to G - 1, shape (users,).
    question
        What is asked, for the sentence.
    """
    samples = _samples(values, groups)
    count = len(samples)
    sizes = np.array([len(each) for each in samples])
    spreads = np.array([each.var(ddof=1) for each in samples])
    if spreads.min() == 0.0:
        raise InputError("values must vary in every group, got one that is constant: leave that group out")
    weights = sizes / spreads
    means = np.array([each.mean() for each in samples])
    middle = (weights * means).sum() / weights.sum()
    uneven = ((1.0 - weights / weights.sum()) ** 2 / (sizes - 1)).sum()
    above = (weights * (means - middle) ** 2).sum() / (count - 1)
    statistic = float(above / (1.0 + 2.0 * (count - 2) / (count**2 - 1) * uneven))
    below = float((count**2 - 1) / (3.0 * uneven))
    return Outcome("Welch", question, "F", statistic, (count - 1, below), float(f.sf(statistic, count - 1, below)))


def kruskal_wallis(values: Array, groups: Ints, *, question: str) -> Outcome:
    """Compare groups by ranks (Kruskal and Wallis 1952); arguments as for :func:`welch`."""
    samples = _samples(values, groups)
    found = kruskal(*samples)
    return Outcome("Kruskal-Wallis", question, "H", float(found.statistic), (len(samples) - 1,), float(found.pvalue))


def friedman(values: Array, *, question: str) -> Outcome:
    """Compare three levels or more within users by ranks (Friedman 1937); `values` has shape (users, levels)."""
    if values.ndim != 2 or values.shape[1] < 3:
        raise InputError(f"levels must be at least three, got {values.shape}: use the permutation test for two")
    found = friedmanchisquare(*values.T)
    degrees = (values.shape[1] - 1,)
    return Outcome("Friedman", question, "chi2", float(found.statistic), degrees, float(found.pvalue))


def hotelling(scores: Array, groups: Ints, *, question: str) -> Outcome:
    """Test mean scores against zero with no sphericity assumed (Hotelling 1931), groups of equal weight.

    Parameters
    ----------
    scores
        Scores of users on contrasts, shape (users, contrasts), from `tissue.evaluation.statistics.strata.scores_of`.
    groups
        Group of every user, shape (users,).
    """
    member = np.equal.outer(np.arange(groups.max() + 1), groups).astype(float)
    counts = member.sum(axis=1)
    means = member @ scores / counts[:, None]
    residuals = scores - member.T @ means
    degrees, width = len(scores) - len(counts), scores.shape[1]
    if degrees < width:
        raise InputError(f"users must outnumber groups and contrasts, got {len(scores)}: add users")
    spread = residuals.T @ residuals / degrees
    middle = means.mean(axis=0)
    weight = len(counts) ** 2 / (1.0 / counts).sum()
    squared = weight * float(middle @ np.linalg.solve(spread, middle))
    below = degrees - width + 1
    statistic = squared * below / (degrees * width)
    return Outcome("Hotelling", question, "F", statistic, (width, below), float(f.sf(statistic, width, below)))


def permutation(
    values: Array,
    groups: Ints,
    sizes: tuple[int, ...],
    chosen: tuple[int, ...],
    *,
    between: bool,
    question: str,
    rng: np.random.Generator,
    count: int = 4999,
) -> Outcome:
    """Compare the F of :func:`tissue.evaluation.statistics.strata.strata` with that of shuffled labels.

    An effect of groups shuffles users over groups; an effect within users shuffles the levels of the chosen factors
    within each user; both are exact where the labels mean nothing (Edgington 1995).
    """
    centred = values
    if chosen and between:
        # Only the effect's own scores are shuffled, so that effects of the group alone do not enter.
        basis = scores_of(np.eye(int(np.prod(sizes))), sizes, chosen)
        centred = values @ basis @ basis.T
    measured = float(strata(centred, groups, sizes, chosen, between=between).F)
    if between:
        order = rng.permuted(np.tile(np.arange(len(groups)), (count, 1)), axis=1)
        shuffled = centred[order]
    else:
        by_level = values.reshape(len(values), *sizes)
        moved = np.moveaxis(by_level, [1 + each for each in chosen], range(1, 1 + len(chosen)))
        flat = moved.reshape(len(values), int(np.prod([sizes[each] for each in chosen])), -1)
        order = rng.permuted(np.tile(np.arange(flat.shape[1]), (count, len(values), 1)), axis=2)
        taken = np.take_along_axis(flat[None], order[..., None], axis=2).reshape(count, *moved.shape)
        shuffled = np.moveaxis(taken, range(2, 2 + len(chosen)), [2 + each for each in chosen])
        shuffled = shuffled.reshape(count, *values.shape)
    others = strata(shuffled, groups, sizes, chosen, between=between).F
    p = (1 + int((others >= measured * (1.0 - 1e-12)).sum())) / (count + 1)
    return Outcome("permutation", question, "F", measured, (), p)


def _samples(values: Array, groups: Ints) -> list[Array]:
    """Values of each group, two or more."""
    samples = [values[groups == group] for group in range(groups.max() + 1)]
    if len(samples) < 2 or min(len(each) for each in samples) < 2:
        raise InputError("groups must be at least two of two users each, got fewer: add users")
    return samples
