"""Several metrics at once: multivariate analysis of variance on users, between groups and within users."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.stats import f

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import Assumption, HypothesisTest, format_p, require_statsmodels
from tissue.evaluation.statistics.normality import mardia
from tissue.evaluation.statistics.strata import group_means, scores_of
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["STATISTICS", "manova", "multivariate", "pillai"]

STATISTICS = ("Pillai's trace", "Wilks' lambda", "Hotelling-Lawley trace", "Roy's greatest root")


def manova(
    table: TrialTable, metrics: Sequence[str], *, factor: Literal["group", "method"], rng: np.random.Generator
) -> HypothesisTest:
    """Compare groups or methods on several metrics at once.

    The unit is the user: groups are compared by users' means over their trials, methods by users' differences between
    methods, so that the rows of the analysis are independent though every user meets every method.

    Parameters
    ----------
    table
        Trials, of one task or of several (a user's means then go over all).
    metrics
        Two metrics or more.
    factor
        What is compared.
    rng
        Shuffles labels for the permutation test beside it.

    Raises
    ------
    InputError
        If the users are too few for the metrics, or one metric is another's multiple.
    """
    cells = [table.cells(metric) for metric in metrics]
    chosen = (0,) if factor == "method" else ()
    scores = np.concatenate([scores_of(each.values, each.sizes, chosen) for each in cells], axis=-1)
    question = f"{', '.join(metrics)}: {factor}"
    return multivariate(scores, cells[0].groups, between=factor == "group", question=question, rng=rng)


def multivariate(
    scores: Array,
    groups: Ints,
    *,
    between: bool,
    question: str,
    rng: np.random.Generator,
    permutations: int = 1999,
) -> HypothesisTest:
    """Multivariate analysis of variance by statsmodels, with its checks and its permutation test.

    Parameters
    ----------
    scores
        One row a user, shape (users, columns).
    groups
        Group of every user, 0 to G - 1, shape (users,).
    between
        Compare groups; if not, test the mean of the columns over groups of equal weight against zero.
    question
        What is asked, for the sentence.

    Returns
    -------
    HypothesisTest
        Pillai's trace, the most robust of the four (Olson 1974), with the other three and a permutation test beside it.
    """
    counts = np.bincount(groups)
    degrees, width = len(scores) - len(counts), scores.shape[1]
    if degrees <= width:
        raise InputError(
            f"users must outnumber groups and columns, got {len(scores)} users, {len(counts)} groups and {width} "
            "columns: add users or drop metrics"
        )
    if between and len(counts) < 2:
        raise InputError("groups must be at least two to be compared, got one: leave the group's test out")
    require_statsmodels()
    from statsmodels.multivariate.manova import MANOVA

    scaled = scores / scores.std(axis=0)
    residuals = scaled - group_means(scaled, groups)[groups]
    if np.linalg.matrix_rank(residuals, tol=1e-8 * len(scores)) < width:
        raise InputError(
            f"columns must not be multiples of one another, got {question}: drop a metric that repeats another"
        )
    member = np.equal.outer(groups, np.arange(len(counts))).astype(float)
    hypothesis = np.eye(len(counts))[:-1] - np.eye(len(counts))[1:] if between else np.full((1, len(counts)), 1.0)
    frame = MANOVA(scaled, member).mv_test([("effect", hypothesis)])["effect"]["stat"]
    first, *others = (
        HypothesisTest(
            f"MANOVA, {name} {row['Value']:.4g}", question, "F", row["F Value"], (row["Num DF"], row["Den DF"]),
            row["Pr > F"],
        )
        for name, row in zip(STATISTICS, frame.loc[list(STATISTICS)].astype(float).to_dict("records"), strict=True)
    )  # fmt: skip
    shuffled = _permuted(scaled, groups, between=between, question=question, rng=rng, count=permutations)
    assumptions = (mardia(residuals), *([_equal_covariances(scaled, groups)] if len(counts) > 1 else []))
    return replace(first, assumptions=assumptions, alternatives=(shuffled, *others))


def pillai(scores: Array, groups: Ints, *, between: bool) -> tuple[Array, Array]:
    """Pillai's trace and its p by the usual F over many populations (Pillai 1955).

    Parameters
    ----------
    scores
        Shape (..., users, columns).
    groups
        Group of every user, shape (users,).
    between
        As for :func:`multivariate`.
    """
    counts = np.bincount(groups)
    means = group_means(scores, groups)
    residuals = scores - means[..., groups, :]
    error = np.swapaxes(residuals, -1, -2) @ residuals
    if between:
        apart = (means - (counts @ means / counts.sum())[..., None, :]) * np.sqrt(counts)[:, None]
        effect, above = np.swapaxes(apart, -1, -2) @ apart, len(counts) - 1
    else:
        middle = means.mean(axis=-2)
        effect = middle[..., :, None] * middle[..., None, :] * len(counts) ** 2 / (1.0 / counts).sum()
        above = 1
    trace = np.trace(np.linalg.solve(effect + error, effect), axis1=-2, axis2=-1)
    below, width = groups.size - len(counts), scores.shape[-1]
    rank = min(width, above)
    m, n = 0.5 * (abs(width - above) - 1), 0.5 * (below - width - 1)
    degrees = rank * (2 * m + rank + 1), rank * (2 * n + rank + 1)
    statistic = trace / degrees[0] / ((rank - trace) / degrees[1])
    return np.asarray(trace), np.asarray(f.sf(statistic, *degrees))


def _permuted(
    scores: Array, groups: Ints, *, between: bool, question: str, rng: np.random.Generator, count: int
) -> HypothesisTest:
    """Pillai's trace against shuffled groups, or against users whose differences have their signs turned."""
    measured = float(pillai(scores, groups, between=between)[0])
    if between:
        shuffled = scores[rng.permuted(np.tile(np.arange(len(groups)), (count, 1)), axis=1)]
    else:
        shuffled = scores * rng.choice([-1.0, 1.0], (count, len(groups), 1))
    others, _ = pillai(shuffled, groups, between=between)
    p = (1 + int((others >= measured * (1.0 - 1e-12)).sum())) / (count + 1)
    return HypothesisTest("permutation of Pillai's trace", question, "V", measured, (), p)


def _equal_covariances(scores: Array, groups: Ints) -> Assumption:
    """Box's (1949) M test, by statsmodels."""
    from statsmodels.stats.multivariate import test_cov_oneway

    counts = np.bincount(groups)
    name = "equal covariances of groups"
    if counts.min() <= scores.shape[1]:
        return Assumption(name, False, "too few users a group for a test")
    found = test_cov_oneway(
        [np.cov(scores[groups == group].T) for group in range(len(counts))], [int(each) for each in counts]
    )
    # Box's test is known to refuse too readily without normality and is customarily held to 0.001 (Tabachnick 2013).
    return Assumption(name, bool(found.pvalue >= 1e-3), f"Box's M {format_p(float(found.pvalue))}")
