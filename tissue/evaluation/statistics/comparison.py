"""Comparison of methods and user groups in a study by sign-flip tests.

The tests that the published study used are reported in addition.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import studentized_range

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
from tissue.evaluation.statistics.mixed import mixed_model
from tissue.evaluation.statistics.sign_flips import EQUAL, SignTest, pair_scores, sign_test
from tissue.evaluation.statistics.strata import (
    Strata,
    effect_scores,
    group_means,
    multivariate,
    strata,
    tukey,
)
from tissue.evaluation.statistics.trials import Cells, TrialTable

ROUNDING = 1e-12
"""Relative variation among users up to which a metric counts as constant (rounding)."""


@dataclass(frozen=True)
class MetricComparison:
    """Tests that compare methods and user groups in one metric of one task.

    Attributes
    ----------
    metric, task
        Names of the compared metric and of the task.
    tests
        Tests of the method, of the group, and of their interaction. A test is omitted if there is
        only one method or only one group.
    pairs
        Tests of all pairs of methods, then of all pairs of groups. Each test has the attribute
        `alternatives`, which contains Tukey's test.
    sizes
        Cohen's d of every pair of methods (from differences within users) and of every pair of
        groups.
    """

    metric: str
    task: str
    tests: tuple[HypothesisTest, ...]
    pairs: tuple[HypothesisTest, ...]
    sizes: tuple[Effect, ...]


def compare(
    table: TrialTable, metric: str, *, task: str, rng: np.random.Generator
) -> MetricComparison:
    """Compare methods and groups in one metric of one task.

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
        If there is only one method and only one group, if a group has only one user, or if the
        metric is constant.
    """
    require_statsmodels()
    cells = table.where(task=task).cells(metric)
    groups = range(len(cells.group_names))
    # a factor: its indices within users, names and values of its levels, and whether it is a group
    factors: list[tuple[tuple[int, ...], tuple[str, ...], list[Array], bool]] = [
        ((0,), cells.factors[0][1], list(cells.values.T), False),
        (
            (),
            cells.group_names,
            [cells.values[cells.groups == group].mean(axis=1) for group in groups],
            True,
        ),
    ]
    factors = [each for each in factors if len(each[1]) > 1]
    if not factors:
        raise InputError(
            "table",
            "have at least two methods or two groups",
            "one of each",
            "add a second method or group",
        )
    tests = []
    pairs: list[HypothesisTest] = []
    sizes: list[Effect] = []
    for chosen, names, samples, between in factors:
        test, signs = stratum_test(cells, chosen, between=between, rng=rng)
        tests.append(test)
        others = tukey_tests(cells.values, cells.groups, names, between=between, metric=metric)
        pairs += _pairs(signs, others)
        for (before, first), (after, second) in combinations(zip(names, samples, strict=True), 2):
            size = cohens_d(second, first, paired=not between)
            sizes.append(replace(size, name=f"{size.name}, {after} minus {before}"))
    if len(factors) > 1:
        tests.append(stratum_test(cells, (0,), between=True, rng=rng)[0])
    return MetricComparison(metric, task, tuple(tests), tuple(pairs), tuple(sizes))


def across_tasks(
    table: TrialTable, metric: str, *, rng: np.random.Generator
) -> list[HypothesisTest]:
    """Test a metric over all tasks by sign flips and by a linear mixed model.

    Each sign-flip test lists the mixed-model test in its `alternatives`. A sign-flip test is
    impossible if the scores do not vary between users. The test of the mixed model is then returned
    instead, with a note.
    """
    mixed = mixed_model(table, metric)
    within = [name for name in ("task", "method") if len(np.unique(getattr(table, name))) > 1]
    cells = table.cells(metric, within=within or ["method"])
    tests = []
    for each in mixed:
        asked = each.question.removeprefix(f"{metric}: ").split(" x ")
        chosen = tuple(index for index, (name, _) in enumerate(cells.factors) if name in asked)
        try:
            test, _ = stratum_test(cells, chosen, between="group" in asked, rng=rng)
        except InputError:
            note = f"{each.question} is tested by the mixed model, as its stratum has no variation."
            tests.append(replace(each, note=note))
            continue
        tests.append(replace(test, question=each.question, alternatives=(each, *test.alternatives)))
    return tests


def stratum_test(
    cells: Cells, factor_indices: tuple[int, ...], *, between: bool, rng: np.random.Generator
) -> tuple[HypothesisTest, SignTest]:
    """Test one effect by sign flips, with F tests as alternatives.

    Parameters
    ----------
    cells
        Means of a metric over the trials of each user.
    factor_indices
        Indices into ``cells.factors``: the factors that belong to the effect.
    between
        True for an effect of the group, or an interaction with the group.
    rng
        Random generator of the sign flips.

    Returns
    -------
    tuple of HypothesisTest and SignTest
        The test, and the results of all pairwise comparisons.
    """
    values = cells.values
    groups = cells.groups
    sizes = cells.sizes
    name = " x ".join(
        (["group"] if between else []) + [cells.factors[index][0] for index in factor_indices]
    )
    question = f"{cells.metric}: {name}"
    exact = strata(values, groups, sizes, factor_indices, between=between)
    if exact.error_square <= (ROUNDING * np.abs(values).max()) ** 2:
        raise InputError(
            cells.metric,
            "vary among users",
            f"no variation except by {name}",
            "report its values without a test",
        )
    scores = pair_scores(values, sizes, factor_indices)
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
        _f_tests(exact, effect_scores(values, sizes, factor_indices), groups, question),
        " ".join(notes),
    )
    return test, signs


def _symmetry(scores: Array, groups: Ints) -> tuple[Assumption, ...]:
    """Check that scores are symmetric, as sign flips assume; needs at least eight users."""
    # D'Agostino's test needs eight values
    if len(scores) < 8:
        return ()
    return (symmetric_residuals(scores - group_means(scores, groups)[groups]),)


def _f_tests(
    exact: Strata, scores: Array, groups: Ints, question: str
) -> tuple[HypothesisTest, ...]:
    """Return the F test of an effect, and the F test corrected for sphericity.

    `exact` contains the F test. `scores`, shape (users, contrasts), are the values of each user for
    orthonormal contrasts.
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

    The analysis has one row per user. For groups, the row is the user's mean over all trials. For
    methods, the row contains the differences between methods for this user. Rows of different users
    are independent. A sign flip changes the signs of a whole row. The statistic is the largest t
    over all metrics and pairs.

    Parameters
    ----------
    table
        Trials of one task or of several. With several tasks, the mean of a user is taken over all
        tasks.
    metrics
        Two metrics or more.
    factor
        Factor to test, "group" or "method".
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
    contrasts = [effect_scores(each.values, each.sizes, chosen) for each in cells]
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


def _pairs(signs: SignTest, others: Sequence[HypothesisTest]) -> list[HypothesisTest]:
    """Return sign-flip tests of all pairs; each contains another test as an alternative."""
    found = []
    for index, other in enumerate(others):
        difference = signs.differences[index]
        error = signs.errors[index]
        reach = signs.critical * error
        ends = np.array([difference - reach, difference + reach])
        # an end at zero stays there in spite of rounding errors
        ends[np.abs(ends) <= EQUAL * abs(difference)] = 0.0
        effect = Effect("difference", difference, *ends.tolist())
        test = HypothesisTest(
            "sign flips", other.question, "t", difference / error, (), signs.pair_p[index], effect
        )
        found.append(replace(test, alternatives=(other,)))
    return found


def tukey_tests(
    values: Array, groups: Ints, names: Sequence[str], *, between: bool, metric: str
) -> list[HypothesisTest]:
    """Compare every pair of groups, or every pair of levels within users, by Tukey's test.

    Parameters
    ----------
    values, groups, between
        As in :func:`tissue.evaluation.statistics.strata.tukey`, for a single population (no leading
        axis).
    names
        Names of the groups, or of the levels.
    metric
        Name of the metric, for the texts of the tests.

    Returns
    -------
    list of HypothesisTest
        Tests of the pairs (0, 1), (0, 2), ... The effect of a test is a difference of means with
        its simultaneous interval.
    """
    differences, errors, degrees = tukey(values, groups, between=between)
    # The quantile takes 0.3 s.
    reaches = studentized_range.ppf(LEVEL, *degrees) * errors
    statistics = np.abs(differences) / errors
    p_values = studentized_range.sf(statistics, *degrees)
    test = "Tukey HSD" if between else "Tukey HSD within users"
    found = []
    for index, (first, second) in enumerate(combinations(names, 2)):
        question = f"{metric}: {second} minus {first}"
        difference = differences[index]
        reach = reaches[index]
        effect = Effect("difference", difference, difference - reach, difference + reach)
        found.append(
            HypothesisTest(test, question, "q", statistics[index], degrees, p_values[index], effect)
        )
    return found


def corrected(p_values: Sequence[float]) -> list[float]:
    """Return Bonferroni-corrected p values: each p times the number of p values, at most 1."""
    return [min(1.0, len(p_values) * p) for p in p_values]
