"""Comparison of methods and groups by sign-flip tests.

The tests of the paper are reported as alternatives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import studentized_range, tukey_hsd

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, counted
from tissue.evaluation.statistics.hypothesis_test import (
    LEVEL,
    Assumption,
    Effect,
    HypothesisTest,
    cohens_d,
    normal_residuals,
    partial_eta_squared,
    require_statsmodels,
    symmetric_residuals,
)
from tissue.evaluation.statistics.mixed import MixedModel, mixed_model
from tissue.evaluation.statistics.sign_flips import SignTest, pair_scores, sign_test
from tissue.evaluation.statistics.strata import (
    Strata,
    group_means,
    multivariate,
    scores_of,
    strata,
)
from tissue.evaluation.statistics.trials import Cells, TrialTable

__all__ = [
    "MetricComparison",
    "across_tasks",
    "compare",
    "corrected",
    "manova",
    "tukey_groups",
]

ROUNDING = 1e-12
"""Largest variation among users, divided by the largest value, that counts as rounding error."""


@dataclass(frozen=True)
class MetricComparison:
    """Comparisons of methods and groups by one metric.

    Attributes
    ----------
    metric, task
        Names of the compared metric and of the task.
    cells
        Mean of the metric for every user under every method.
    tests
        Tests of the method, of the group, and of their interaction. Tests for which the table has
        too few methods or groups are omitted.
    pairs
        Tests of all pairs of methods, then of all pairs of groups. Each test has Tukey's test as
        its alternative.
    sizes
        Cohen's d of every pair of methods (from differences within users) and of every pair of
        groups.
    """

    metric: str
    task: str
    cells: Cells
    tests: tuple[HypothesisTest, ...]
    pairs: tuple[HypothesisTest, ...]
    sizes: tuple[Effect, ...]


def compare(
    table: TrialTable, metric: str, *, task: str, rng: np.random.Generator
) -> MetricComparison:
    """Compare methods and groups by one metric on one task.

    Parameters
    ----------
    table
        Trials of a study.
    metric
        Name of the metric.
    task
        Name of the task. Tasks are not pooled, because their metrics have different scales.
    rng
        Random generator of the sign flips.

    Raises
    ------
    InputError
        If there is only one method and one group, a group has only one user, or the metric is
        constant.
    """
    require_statsmodels()
    cells = table.where(task=task).cells(metric)
    level_count = cells.values.shape[1]
    group_count = len(cells.group_names)
    if level_count < 2 and group_count < 2:
        raise InputError(
            "table", "hold two methods or two groups", "one of each", "add a second method or group"
        )
    tests = []
    pairs: list[HypothesisTest] = []
    sizes: tuple[Effect, ...] = ()
    if level_count > 1:
        names = cells.factors[0][1]
        test, signs = stratum_test(cells, (0,), between=False, rng=rng)
        tests.append(test)
        pairs += _pairs(signs, tukey_levels(cells.values, names, cells.groups, metric=metric))
        sizes += _sizes(cells.values.T, names, paired=True)
    if group_count > 1:
        samples = [cells.values[cells.groups == group].mean(axis=1) for group in range(group_count)]
        test, signs = stratum_test(cells, (), between=True, rng=rng)
        tests.append(test)
        pairs += _pairs(signs, tukey_groups(samples, cells.group_names, metric=metric))
        sizes += _sizes(samples, cells.group_names, paired=False)
    if level_count > 1 and group_count > 1:
        tests.append(stratum_test(cells, (0,), between=True, rng=rng)[0])
    return MetricComparison(metric, task, cells, tuple(tests), tuple(pairs), sizes)


def across_tasks(table: TrialTable, metric: str, *, rng: np.random.Generator) -> MixedModel:
    """Test a metric over all tasks by sign flips and by a linear mixed model.

    The returned model contains the tests by sign flips. Each of these tests has the test of the
    mixed model as an alternative. If the error term of a question has no variation, the test of the
    mixed model takes the place of the test by sign flips, with a note.
    """
    mixed = mixed_model(table, metric)
    within = [name for name in ("task", "method") if len(np.unique(getattr(table, name))) > 1]
    cells = table.cells(metric, within=within or ["method"])
    tests = []
    for each in mixed.tests:
        asked = each.question.removeprefix(f"{metric}: ").split(" x ")
        chosen = tuple(index for index, (name, _) in enumerate(cells.factors) if name in asked)
        try:
            test, _ = stratum_test(cells, chosen, between="group" in asked, rng=rng)
        except InputError:
            note = f"{each.question} is tested by the mixed model, as its stratum has no variation."
            tests.append(replace(each, note=note))
            continue
        tests.append(replace(test, question=each.question, alternatives=(each, *test.alternatives)))
    return replace(mixed, tests=tuple(tests))


def stratum_test(
    cells: Cells, within: tuple[int, ...], *, between: bool, rng: np.random.Generator
) -> tuple[HypothesisTest, SignTest]:
    """Test one effect by sign flips, with F tests as alternatives.

    Parameters
    ----------
    cells
        Means of a metric over the trials of each user.
    within
        Factors within users that belong to the effect, as indices into ``cells.factors``.
    between
        True if the effect involves the group.
    rng
        Random generator of the sign flips.

    Returns
    -------
    tuple of HypothesisTest and SignTest
        Test for the report, and the results of the comparisons of pairs.
    """
    values = cells.values
    groups = cells.groups
    sizes = cells.sizes
    name = " x ".join(
        (["group"] if between else []) + [cells.factors[index][0] for index in within]
    )
    question = f"{cells.metric}: {name}"
    exact = strata(values, groups, sizes, within, between=between)
    if exact.error_square <= (ROUNDING * np.abs(values).max()) ** 2:
        raise InputError(
            cells.metric,
            "vary among users",
            f"no variation other than {name}",
            "report its values without a test",
        )
    scores = pair_scores(values, sizes, within)
    signs = sign_test(scores, groups, between=between, rng=rng)
    notes = []
    if cells.dropped:
        notes.append(
            f"Left out: {counted(len(cells.dropped), 'user')} without a whole set of trials."
        )
    if np.ptp(cells.counts) > 0:
        notes.append("Means of users rest on unequal numbers of trials.")
    test = HypothesisTest(
        "sign flips",
        question,
        "largest t",
        signs.statistic,
        (),
        signs.p,
        partial_eta_squared(float(exact.F), *exact.degrees),
        _symmetry(scores, groups),
        _f_tests(exact, scores_of(values, sizes, within), groups, question),
        " ".join(notes),
    )
    return test, signs


def _symmetry(scores: Array, groups: Ints) -> tuple[Assumption, ...]:
    """Check the symmetry that sign flips assume, if there are at least eight users."""
    # D'Agostino's test needs eight values
    if len(scores) < 8:
        return ()
    return (symmetric_residuals(scores - group_means(scores, groups)[groups]),)


def _f_tests(
    exact: Strata, scores: Array, groups: Ints, question: str
) -> tuple[HypothesisTest, ...]:
    """Return the F test of an effect, and the F test corrected for sphericity.

    `exact` is the F test of the effect. `scores` are the scores of users on orthonormal contrasts,
    shape (users, contrasts).
    """
    statistic = float(exact.F)
    residuals = scores - group_means(scores, groups)[groups]
    # Anderson and Darling's test needs eight values
    normal = (normal_residuals(residuals),) if residuals.size >= 8 else ()
    test = HypothesisTest(
        "F of strata",
        question,
        "F",
        statistic,
        exact.degrees,
        float(exact.p),
        assumptions=normal,
    )
    # one contrast is spherical by itself
    if scores.shape[1] == 1:
        return (test,)
    degrees = tuple(float(exact.epsilon) * each for each in exact.degrees)
    p = float(exact.corrected_p)
    return (test, HypothesisTest("Greenhouse-Geisser", question, "F", statistic, degrees, p))


def manova(
    table: TrialTable,
    metrics: Sequence[str],
    *,
    factor: str,
    rng: np.random.Generator,
) -> HypothesisTest:
    """Compare groups or methods on several metrics at once, by sign flips and by MANOVA.

    The analysis has one row per user. Groups are compared by the means of users over their trials,
    and methods by the differences between methods within users. The rows are therefore independent,
    although every user has trials under every method. Each sign flip changes the signs of all
    metrics of a user together. The statistic is the largest t over all metrics and pairs.

    Parameters
    ----------
    table
        Trials of one task or of several. With several tasks, the means of a user are taken over all
        tasks.
    metrics
        Two metrics or more.
    factor
        Compared factor, "group" or "method".
    rng
        Random generator of the sign flips.

    Raises
    ------
    InputError
        If there are too few users for the number of metrics, or one metric is a multiple of
        another.
    """
    cells = [table.cells(metric) for metric in metrics]
    groups = cells[0].groups
    between = factor == "group"
    chosen = () if between else (0,)
    question = f"{', '.join(metrics)}: {factor}"
    contrasts = [scores_of(each.values, each.sizes, chosen) for each in cells]
    paper = multivariate(
        np.concatenate(contrasts, axis=-1), groups, between=between, question=question
    )
    pairs = [pair_scores(each.values, each.sizes, chosen) for each in cells]
    scores = np.concatenate(pairs, axis=-1)
    signs = sign_test(scores, groups, between=between, rng=rng)
    return HypothesisTest(
        "sign flips",
        question,
        "largest t",
        signs.statistic,
        (),
        signs.p,
        assumptions=_symmetry(scores, groups),
        alternatives=(paper,),
    )


def _pairs(signs: SignTest, tukey: Sequence[HypothesisTest]) -> list[HypothesisTest]:
    """Return the sign-flip test of each pair, with Tukey's test of the pair as an alternative."""
    found = []
    for index, other in enumerate(tukey):
        difference = signs.differences[index]
        error = signs.errors[index]
        reach = signs.critical * error
        effect = Effect("difference", difference, difference - reach, difference + reach)
        found.append(
            HypothesisTest(
                "sign flips",
                other.question,
                "t",
                difference / error,
                (),
                signs.pair_p[index],
                effect,
                alternatives=(other,),
            )
        )
    return found


def _sizes(
    samples: Sequence[Array] | Array, names: Sequence[str], *, paired: bool
) -> tuple[Effect, ...]:
    """Return Cohen's d of every pair of samples."""
    found = []
    for (before, first), (after, second) in combinations(zip(names, samples, strict=True), 2):
        size = cohens_d(second, first, paired=paired)
        found.append(replace(size, name=f"{size.name}, {after} minus {before}"))
    return tuple(found)


def tukey_groups(
    samples: Sequence[ArrayLike], names: Sequence[str], *, metric: str
) -> tuple[HypothesisTest, ...]:
    """Compare every pair of groups by Tukey and Kramer's test.

    Parameters
    ----------
    samples
        Values of two groups or more, one value per user, each of shape (users,).
    names
        Names of the groups.
    metric
        Name of the metric, for the question of the tests.

    Returns
    -------
    tuple of HypothesisTest
        Tests in the order of pairs (0, 1), (0, 2), ... The effects are differences of means with
        simultaneous intervals.

    Raises
    ------
    InputError
        If the values do not vary within any group.
    """
    groups = [np.asarray(each, dtype=float) for each in samples]
    if max(np.ptp(group) for group in groups) == 0.0:
        raise InputError(
            "groups",
            "have values that vary within a group",
            "constant values",
            "leave the metric out",
        )
    pooled = tukey_hsd(*groups)
    ends = pooled.confidence_interval(LEVEL)
    found = []
    for pair in combinations(range(len(groups)), 2):
        at = pair[::-1]
        question = f"{metric}: {names[pair[1]]} minus {names[pair[0]]}"
        difference = pooled.statistic[at]
        effect = Effect("difference", difference, ends.low[at], ends.high[at])
        p = pooled.pvalue[at]
        test = HypothesisTest("Tukey HSD", question, "difference", difference, (), p, effect)
        found.append(test)
    return tuple(found)


def tukey_levels(
    values: Array, names: Sequence[str], groups: Ints, *, metric: str
) -> tuple[HypothesisTest, ...]:
    """Compare every pair of levels of a factor within users by Tukey's test.

    All users have values at all levels. The error term is the interaction of users with levels,
    pooled over the levels.

    Parameters
    ----------
    values
        Cell means, shape (users, levels).
    names
        Names of the levels.
    groups
        Group of every user, shape (users,). The effect of the group, and its interaction with the
        level, are removed from the error term.
    metric
        Name of the metric, for the question of the tests.
    """
    found = strata(values, groups, (values.shape[1],), (0,), between=False)
    counts = np.bincount(groups)
    means = group_means(values, groups).mean(axis=0)
    error = np.sqrt(found.error_square * (1.0 / counts).sum() / len(counts) ** 2)
    degrees = (len(means), found.degrees[1])
    # The quantile takes 0.3 s.
    reach = studentized_range.ppf(LEVEL, *degrees) * error
    tests = []
    for a, b in combinations(range(len(names)), 2):
        question = f"{metric}: {names[b]} minus {names[a]}"
        difference = means[b] - means[a]
        statistic = abs(difference) / error
        effect = Effect("difference", difference, difference - reach, difference + reach)
        p = studentized_range.sf(statistic, *degrees)
        tests.append(
            HypothesisTest("Tukey HSD within users", question, "q", statistic, degrees, p, effect)
        )
    return tuple(tests)


def corrected(p_values: Sequence[float]) -> list[float]:
    """Multiply the p values of a family of tests by their number (Bonferroni), up to at most 1."""
    return [min(1.0, len(p_values) * p) for p in p_values]
