"""All pairs at once: Tukey's honest significant difference, Games and Howell's, and corrections of p values."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import studentized_range, ttest_rel

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import LEVEL, Effect, HypothesisTest
from tissue.evaluation.statistics.strata import group_means, strata

__all__ = ["corrected", "tukey_groups", "tukey_levels"]


def tukey_groups(samples: Sequence[ArrayLike], names: Sequence[str], *, metric: str) -> tuple[HypothesisTest, ...]:
    """Every pair of groups by Tukey (1949), Kramer's (1956) form for unequal sizes.

    Beside each stands the test of Games and Howell (1976), for groups whose variances may differ.

    Parameters
    ----------
    samples
        Values of each group, one a user, two or more, each of shape (users,).
    names
        Names of the groups.
    metric
        What is compared, for the sentence.

    Returns
    -------
    tuple of HypothesisTest
        In the order of pairs (0, 1), (0, 2), ...; effects are differences of means with simultaneous intervals.

    Raises
    ------
    InputError
        If no group varies within.
    """
    groups = [np.asarray(each, dtype=float) for each in samples]
    if max(np.ptp(group) for group in groups) == 0.0:
        raise InputError("groups must vary within, got constants: a difference has then no error to be held against")
    counts = np.array([len(each) for each in groups])
    means, variances = (np.array(each) for each in zip(*((g.mean(), g.var(ddof=1)) for g in groups), strict=True))
    below, shares = counts.sum() - len(counts), variances / counts
    square = variances @ (counts - 1) / below
    found = []
    for pair in combinations(range(len(groups)), 2):
        a, b = pair
        error = np.sqrt(0.5 * square * (1.0 / counts[a] + 1.0 / counts[b]))
        total = shares[a] + shares[b]
        free = total**2 / (shares[a] ** 2 / (counts[a] - 1) + shares[b] ** 2 / (counts[b] - 1))
        other = _pair("Games-Howell", means, names, pair, np.sqrt(0.5 * total), free, metric)
        found.append(replace(_pair("Tukey HSD", means, names, pair, error, int(below), metric), alternatives=(other,)))
    return tuple(found)


def tukey_levels(values: Array, names: Sequence[str], groups: Ints, *, metric: str) -> tuple[HypothesisTest, ...]:
    """Every pair of levels that all users met, by Tukey; each with the paired t test, corrected by Holm.

    The error is how differently users take the levels (their interaction), pooled over levels, which needs sphericity;
    the paired test does not.

    Parameters
    ----------
    values
        Cell means, shape (users, levels).
    names
        Names of the levels.
    groups
        Group of every user, shape (users,); effects of groups and how they differ with the level leave the error.
    metric
        What is compared, for the sentence.
    """
    found = strata(values, groups, (values.shape[1],), (0,), between=False)
    counts = np.bincount(groups)
    means = group_means(values, groups).mean(axis=0)
    error = float(np.sqrt(float(found.error_square) * (1.0 / counts).sum() / len(counts) ** 2))
    pairs = list(combinations(range(len(names)), 2))
    raw = [ttest_rel(values[:, b], values[:, a]) for a, b in pairs]
    p_values = corrected([float(each.pvalue) for each in raw], "holm")
    tests = []
    for pair, each, p in zip(pairs, raw, p_values, strict=True):
        test = _pair("Tukey HSD within users", means, names, pair, error, found.degrees[1], metric)
        other = HypothesisTest("paired t, Holm", test.question, "t", float(each.statistic), (float(each.df),), p)
        tests.append(replace(test, alternatives=(other,)))
    return tuple(tests)


def corrected(p_values: Sequence[float], correction: Literal["bonferroni", "holm"]) -> list[float]:
    """P values of a family of tests, corrected so that one false alarm in the family stays at the nominal chance.

    Holm's (1979) correction rests on no more than Bonferroni's and never rejects less.
    """
    if not p_values:
        return []
    from statsmodels.stats.multitest import multipletests

    return multipletests(p_values, method=correction)[1].tolist()


def _pair(
    test: str,
    means: Array,
    names: Sequence[str],
    pair: tuple[int, int],
    error: float,
    below: float,
    metric: str,
) -> HypothesisTest:
    """One pair by the studentized range, with its simultaneous interval."""
    a, b = pair
    count, difference = len(means), float(means[b] - means[a])
    half, statistic = float(_critical(count, below) * error), float(abs(difference) / error)
    p = float(studentized_range.sf(statistic, count, below))
    effect = Effect("difference", difference, difference - half, difference + half)
    return HypothesisTest(test, f"{metric}: {names[b]} minus {names[a]}", "q", statistic, (count, below), p, effect)


@cache
def _critical(count: int, below: float) -> float:
    """Studentized range that :data:`LEVEL` of families stay under; a third of a second each, so kept."""
    return float(studentized_range.ppf(LEVEL, count, below))
