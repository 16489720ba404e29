"""Comparison of one metric: tests with checked assumptions, tests with fewer assumptions, and
all pairs at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import levene, studentized_range, tukey_hsd

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import (
    ALPHA,
    LEVEL,
    Assumption,
    Effect,
    HypothesisTest,
    cohens_d,
    format_p,
    normal_residuals,
    partial_eta_squared,
    require_statsmodels,
)
from tissue.evaluation.statistics.mixed import MixedModel, mixed_model
from tissue.evaluation.statistics.strata import (
    group_means,
    mauchly,
    permutation,
    scores_of,
    strata,
)
from tissue.evaluation.statistics.trials import Cells, TrialTable

__all__ = [
    "MetricComparison",
    "across_tasks",
    "compare",
    "corrected",
    "stratum_test",
    "tukey_groups",
    "tukey_levels",
]

ROUNDING = 1e-12
"""Variation among users below this share of the values is the rounding of their sums."""


@dataclass(frozen=True)
class MetricComparison:
    """Comparisons of one metric.

    Attributes
    ----------
    metric, task
        Compared metric, and its task.
    cells
        Means of every user under every method.
    tests
        Exact tests of method, group and both, if the table holds them.
    pairs
        All pairs of methods, then of groups.
    sizes
        Cohen's d of every pair of methods (from differences within users) and of groups.
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
        Name of the task. Tasks are not pooled, since their metrics have different scales.
    rng
        Generator that shuffles labels for permutation tests.

    Raises
    ------
    InputError
        If there is nothing to compare, only one user per group, or a constant metric.
    """
    require_statsmodels()
    cells = table.where(task=task).cells(metric)
    level_count = cells.values.shape[1]
    group_count = len(cells.group_names)
    if level_count < 2 and group_count < 2:
        raise InputError(
            "table", "hold two methods or two groups", "one of each", "there is nothing to compare"
        )
    wanted = [((0,), False)] * (level_count > 1) + [((), True)] * (group_count > 1)
    wanted += [((0,), True)] * (level_count > 1 and group_count > 1)
    tests = tuple(
        stratum_test(cells, within, between=between, rng=rng) for within, between in wanted
    )
    pairs: tuple[HypothesisTest, ...] = ()
    sizes: tuple[Effect, ...] = ()
    if level_count > 1:
        names = cells.factors[0][1]
        pairs += tukey_levels(cells.values, names, cells.groups, metric=metric)
        sizes += _sizes(cells.values.T, names, paired=True)
    if group_count > 1:
        samples = [cells.values[cells.groups == group].mean(axis=1) for group in range(group_count)]
        pairs += tukey_groups(samples, cells.group_names, metric=metric)
        sizes += _sizes(samples, cells.group_names, paired=False)
    return MetricComparison(metric, task, cells, tests, pairs, sizes)


def across_tasks(table: TrialTable, metric: str, *, rng: np.random.Generator) -> MixedModel:
    """Fit the mixed model over all tasks.

    Each test is listed with the exact test of its stratum and with tests of fewer assumptions. A
    question whose stratum holds no variation keeps only the model's test.
    """
    mixed = mixed_model(table, metric)
    within = [name for name in ("task", "method") if len(np.unique(getattr(table, name))) > 1]
    cells = table.cells(metric, within=within or ["method"])
    tests = []
    for each in mixed.tests:
        asked = each.question.removeprefix(f"{metric}: ").split(" x ")
        chosen = tuple(index for index, (name, _) in enumerate(cells.factors) if name in asked)
        try:
            exact = stratum_test(cells, chosen, between="group" in asked, rng=rng)
            others = (replace(exact, assumptions=(), alternatives=()), *exact.alternatives)
        except InputError:
            others = ()
        tests.append(replace(each, alternatives=others))
    return replace(mixed, tests=tuple(tests))


def stratum_test(
    cells: Cells, within: tuple[int, ...], *, between: bool, rng: np.random.Generator
) -> HypothesisTest:
    """Test one effect exactly, with its checks and tests with fewer assumptions.

    Parameters
    ----------
    cells
        Means of a metric.
    within
        Factors within users in the effect, as indices into ``cells.factors``.
    between
        True if the effect involves the group.
    rng
        Generator that shuffles labels.
    """
    values = cells.values
    groups = cells.groups
    sizes = cells.sizes
    name = " x ".join(
        (["group"] if between else []) + [cells.factors[index][0] for index in within]
    )
    question = f"{cells.metric}: {name}"
    found = strata(values, groups, sizes, within, between=between)
    scores = scores_of(values, sizes, within)
    if float(found.error_square) <= (ROUNDING * float(np.abs(values).max())) ** 2:
        raise InputError(
            cells.metric,
            "vary among users to be tested",
            f"no variation other than {name}",
            "print its values, which need no test",
        )
    residuals = scores - group_means(scores, groups)[groups]
    assumptions: list[Assumption] = []
    # Anderson and Darling's test needs eight values
    if residuals.size >= 8:
        assumptions.append(normal_residuals(residuals))
    shuffled_F, shuffled = permutation(values, groups, sizes, within, between=between, rng=rng)
    others = [HypothesisTest("permutation", question, "F", shuffled_F, (), shuffled)]
    # one contrast is spherical by itself
    if scores.shape[1] > 1:
        epsilon = float(found.epsilon)
        p = mauchly(scores, groups)
        # NaN, where users are too few for the test, counts as not shown.
        finding = f"Mauchly {format_p(p)}, epsilon {epsilon:.2f}"
        assumptions.append(Assumption("sphericity", bool(p >= ALPHA), finding))
        degrees = tuple(epsilon * each for each in found.degrees)
        others.append(
            HypothesisTest(
                "Greenhouse-Geisser",
                question,
                "F",
                float(found.F),
                degrees,
                float(found.corrected_p),
            )
        )
    # about the median, two values of a group always have the same distance
    if between and min(np.bincount(groups)) > 2:
        assumptions.append(_equal_variances(scores, groups))
    notes = (
        [f"{len(cells.dropped)} users without a whole set of trials are left out."]
        if cells.dropped
        else []
    )
    notes += (
        ["Means of users rest on unequal numbers of trials."] if np.ptp(cells.counts) > 0 else []
    )
    effect = partial_eta_squared(float(found.F), *found.degrees)
    return HypothesisTest(
        "analysis of strata",
        question,
        "F",
        float(found.F),
        found.degrees,
        float(found.p),
        effect,
        tuple(assumptions),
        tuple(others),
        " ".join(notes),
    )


def _sizes(
    samples: Sequence[Array] | Array, names: Sequence[str], *, paired: bool
) -> tuple[Effect, ...]:
    """Return Cohen's d of every pair of samples."""
    found = []
    for (before, first), (after, second) in combinations(zip(names, samples, strict=True), 2):
        size = cohens_d(second, first, paired=paired)
        found.append(replace(size, name=f"{size.name}, {after} minus {before}"))
    return tuple(found)


def _equal_variances(scores: Array, groups: Ints) -> Assumption:
    """Run Levene's test about medians (Brown and Forsythe 1974): smallest p of the columns, by
    Bonferroni.
    """
    found = levene(*(scores[groups == group] for group in range(groups.max() + 1)), axis=0).pvalue
    p = min(1.0, len(found) * float(found.min()))
    return Assumption("equal variances of groups", p >= ALPHA, f"Brown-Forsythe {format_p(p)}")


def tukey_groups(
    samples: Sequence[ArrayLike], names: Sequence[str], *, metric: str
) -> tuple[HypothesisTest, ...]:
    """Compare every pair of groups by Tukey and Kramer's test.

    Parameters
    ----------
    samples
        Values of each group, one per user, two groups or more, each of shape (users,).
    names
        Names of the groups.
    metric
        Name of the metric, for the sentence.

    Returns
    -------
    tuple of HypothesisTest
        Tests in the order of pairs (0, 1), (0, 2), ... The effects are differences of means with
        simultaneous intervals.

    Raises
    ------
    InputError
        If no group varies within.
    """
    groups = [np.asarray(each, dtype=float) for each in samples]
    if max(np.ptp(group) for group in groups) == 0.0:
        raise InputError("groups", "vary within", "constants", "leave the metric out")
    pooled = tukey_hsd(*groups)
    ends = pooled.confidence_interval(LEVEL)
    found = []
    for pair in combinations(range(len(groups)), 2):
        at = pair[::-1]
        question = f"{metric}: {names[pair[1]]} minus {names[pair[0]]}"
        difference = float(pooled.statistic[at])
        effect = Effect("difference", difference, float(ends.low[at]), float(ends.high[at]))
        p = float(pooled.pvalue[at])
        test = HypothesisTest("Tukey HSD", question, "difference", difference, (), p, effect)
        found.append(test)
    return tuple(found)


def tukey_levels(
    values: Array, names: Sequence[str], groups: Ints, *, metric: str
) -> tuple[HypothesisTest, ...]:
    """Compare every pair of levels by Tukey's test.

    All users have values at all levels. The error is the interaction of users with levels, pooled
    over levels.

    Parameters
    ----------
    values
        Cell means, shape (users, levels).
    names
        Names of the levels.
    groups
        Group of every user, shape (users,). Effects of groups and their interaction with the level
        are removed from the error.
    metric
        Name of the metric, for the sentence.
    """
    found = strata(values, groups, (values.shape[1],), (0,), between=False)
    counts = np.bincount(groups)
    means = group_means(values, groups).mean(axis=0)
    error = float(np.sqrt(float(found.error_square) * (1.0 / counts).sum() / len(counts) ** 2))
    degrees = (len(means), found.degrees[1])
    # The quantile takes 0.3 s.
    reach = float(studentized_range.ppf(LEVEL, *degrees)) * error
    tests = []
    for a, b in combinations(range(len(names)), 2):
        question = f"{metric}: {names[b]} minus {names[a]}"
        difference = float(means[b] - means[a])
        statistic = abs(difference) / error
        effect = Effect("difference", difference, difference - reach, difference + reach)
        p = float(studentized_range.sf(statistic, *degrees))
        tests.append(
            HypothesisTest("Tukey HSD within users", question, "q", statistic, degrees, p, effect)
        )
    return tuple(tests)


def corrected(p_values: Sequence[float]) -> list[float]:
    """Correct the p values of a family of tests by Bonferroni's factor."""
    return [min(1.0, len(p_values) * p) for p in p_values]
