"""Tests that rest on less: no equal variances, no normality, no sphericity."""

import numpy as np
from scipy.stats import f, friedmanchisquare, kruskal

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import HypothesisTest
from tissue.evaluation.statistics.strata import group_means, scores_of, strata

__all__ = ["friedman", "hotelling", "kruskal_wallis", "permutation", "welch"]


def welch(values: Array, groups: Ints, *, question: str) -> HypothesisTest:
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
    from statsmodels.stats.oneway import anova_oneway

    samples = _samples(values, groups)
    if min(np.ptp(each) for each in samples) == 0.0:
        raise InputError("values must vary in every group, got one that is constant: leave that group out")
    found = anova_oneway(samples, use_var="unequal", welch_correction=True)
    degrees = (int(found.df_num), float(found.df_denom))
    return HypothesisTest("Welch", question, "F", float(found.statistic), degrees, float(found.pvalue))


def kruskal_wallis(values: Array, groups: Ints, *, question: str) -> HypothesisTest:
    """Compare groups by ranks (Kruskal and Wallis 1952); arguments as for :func:`welch`."""
    samples = _samples(values, groups)
    statistic, p = map(float, kruskal(*samples))
    return HypothesisTest("Kruskal-Wallis", question, "H", statistic, (len(samples) - 1,), p)


def friedman(values: Array, *, question: str) -> HypothesisTest:
    """Compare three levels or more within users by ranks (Friedman 1937); `values` has shape (users, levels)."""
    statistic, p = map(float, friedmanchisquare(*values.T))
    return HypothesisTest("Friedman", question, "chi2", statistic, (values.shape[1] - 1,), p)


def hotelling(scores: Array, groups: Ints, *, question: str) -> HypothesisTest:
    """Test mean scores against zero with no sphericity assumed (Hotelling 1931), groups of equal weight.

    Parameters
    ----------
    scores
        Scores of users on contrasts, shape (users, contrasts), from `tissue.evaluation.statistics.strata.scores_of`;
        users outnumber groups and contrasts.
    groups
        Group of every user, shape (users,).
    """
    counts = np.bincount(groups)
    means = group_means(scores, groups)
    residuals = scores - means[groups]
    degrees, width = len(scores) - len(counts), scores.shape[1]
    spread = residuals.T @ residuals / degrees
    middle = means.mean(axis=0)
    weight = len(counts) ** 2 / (1.0 / counts).sum()
    squared = weight * float(middle @ np.linalg.solve(spread, middle))
    below = degrees - width + 1
    statistic = squared * below / (degrees * width)
    return HypothesisTest("Hotelling", question, "F", statistic, (width, below), float(f.sf(statistic, width, below)))


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
) -> HypothesisTest:
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
    return HypothesisTest("permutation", question, "F", measured, (), p)


def _samples(values: Array, groups: Ints) -> list[Array]:
    """Values of each group."""
    return [values[groups == group] for group in range(groups.max() + 1)]
