"""Several metrics at once: multivariate analysis of variance on users, between groups and within
users.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import (
    Assumption,
    HypothesisTest,
    format_p,
    mardia,
    require_statsmodels,
)
from tissue.evaluation.statistics.strata import (
    group_means,
    pillai,
    scores_of,
    shuffled_p,
    shuffled_users,
)
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["STATISTICS", "manova", "multivariate"]

STATISTICS = ("Pillai's trace", "Wilks' lambda", "Hotelling-Lawley trace", "Roy's greatest root")


def manova(
    table: TrialTable,
    metrics: Sequence[str],
    *,
    factor: Literal["group", "method"],
    rng: np.random.Generator,
) -> HypothesisTest:
    """Compare groups or methods on several metrics at once.

    The unit is the user. Groups are compared by users' means over their trials, and methods by
    users' differences between methods. The rows of the analysis are therefore independent, although
    every user has trials under every method.

    Parameters
    ----------
    table
        Trials, of one task or of several (a user's means then go over all).
    metrics
        Two metrics or more.
    factor
        Compared factor.
    rng
        Generator that shuffles labels for the additional permutation test.

    Raises
    ------
    InputError
        If there are too few users for the metrics, or one metric is a multiple of another.
    """
    cells = [table.cells(metric) for metric in metrics]
    chosen = (0,) if factor == "method" else ()
    scores = np.concatenate([scores_of(each.values, each.sizes, chosen) for each in cells], axis=-1)
    question = f"{', '.join(metrics)}: {factor}"
    return multivariate(
        scores, cells[0].groups, between=factor == "group", question=question, rng=rng
    )


def multivariate(
    scores: Array,
    groups: Ints,
    *,
    between: bool,
    question: str,
    rng: np.random.Generator,
    permutations: int = 1999,
) -> HypothesisTest:
    """Run a multivariate analysis of variance by statsmodels, with checks and a permutation test.

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
        Pillai's trace, the most robust of the four statistics (Olson 1974), with the other three
        and a permutation test as alternatives.
    """
    counts = np.bincount(groups)
    width = scores.shape[1]
    if len(scores) - len(counts) <= width:
        raise InputError(
            "users",
            "outnumber groups and columns",
            f"{len(scores)} users, {len(counts)} groups and {width} columns",
            "add users or drop metrics",
        )
    if between and len(counts) < 2:
        raise InputError(
            "groups", "be at least two to be compared", "one", "leave the group's test out"
        )
    require_statsmodels()
    from statsmodels.multivariate.manova import MANOVA

    scaled = scores / scores.std(axis=0)
    residuals = scaled - group_means(scaled, groups)[groups]
    if np.linalg.matrix_rank(residuals, tol=1e-8 * len(scores)) < width:
        raise InputError(
            "columns",
            "not be multiples of one another",
            question,
            "drop a metric that repeats another",
        )
    member = np.equal.outer(groups, np.arange(len(counts))).astype(float)
    hypothesis = np.full((1, len(counts)), 1.0)
    if between:
        hypothesis = np.eye(len(counts))[:-1] - np.eye(len(counts))[1:]
    frame = MANOVA(scaled, member).mv_test([("effect", hypothesis)])["effect"]["stat"]
    first, *others = (
        HypothesisTest(
            f"MANOVA, {name} {row['Value']:.4g}",
            question,
            "F",
            row["F Value"],
            (row["Num DF"], row["Den DF"]),
            row["Pr > F"],
        )
        for name, row in zip(
            STATISTICS, frame.loc[list(STATISTICS)].astype(float).to_dict("records"), strict=True
        )
    )
    # Groups are shuffled among users; differences within users have their signs turned.
    if between:
        shuffled = shuffled_users(scaled, permutations, rng)
    else:
        shuffled = scaled * rng.choice([-1.0, 1.0], (permutations, len(groups), 1))
    trace = float(pillai(scaled, groups, between=between).trace)
    p = shuffled_p(trace, pillai(shuffled, groups, between=between).trace)
    permuted = HypothesisTest("permutation of Pillai's trace", question, "V", trace, (), p)
    assumptions = [mardia(residuals)]
    if len(counts) > 1:
        assumptions.append(_equal_covariances(scaled, groups))
    return replace(first, assumptions=tuple(assumptions), alternatives=(permuted, *others))


def _equal_covariances(scores: Array, groups: Ints) -> Assumption:
    """Run Box's (1949) M test, by statsmodels."""
    from statsmodels.stats.multivariate import test_cov_oneway

    counts = np.bincount(groups)
    name = "equal covariances of groups"
    if counts.min() <= scores.shape[1]:
        return Assumption(name, False, "too few users a group for a test")
    found = test_cov_oneway(
        [np.cov(scores[groups == group].T) for group in range(len(counts))],
        [int(each) for each in counts],
    )
    # Box's test is known to refuse too readily without normality and is customarily held to 0.001
    # (Tabachnick 2013).
    return Assumption(name, bool(found.pvalue >= 1e-3), f"Box's M {format_p(float(found.pvalue))}")
