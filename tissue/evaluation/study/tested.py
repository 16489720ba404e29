"""Report sections on the statistics of a study.

They cover tests, sizes of effects, index, regression and power.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from meshes.base.errors import InputError
from tissue.evaluation.statistics.comparison import (
    MetricComparison,
    across_tasks,
    compare,
    corrected,
)
from tissue.evaluation.statistics.hpi import composite_index, redrawn_power
from tissue.evaluation.statistics.hypothesis_test import ALPHA, Effect, HypothesisTest, format_p
from tissue.evaluation.statistics.mixed import trial_regression
from tissue.evaluation.statistics.strata import manova
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import COMPARED, DIRECTIONS, USERS
from tissue.evaluation.study.section import COMPOSITE, Section, drawing, image, methods_of, tasks_of

__all__ = ["composite_section", "power_section", "regression_section", "tests_sections"]

LOOSE = 0.06
"""False alarms of a test at 5 %, above which it is reported that it finds too much."""

Content = tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, ...], ...]]
"""Sentences, header and rows of a section."""


def tests_sections(table: TrialTable, rng: np.random.Generator) -> list[Section]:
    """Test every metric on every task, then all metrics together.

    The sizes of effects are reported with a picture.
    """
    found: list[MetricComparison] = []
    outcomes: list[tuple[str, HypothesisTest]] = []
    same: dict[str, list[str]] = {}
    refused: dict[str, list[str]] = {}

    @contextmanager
    def attempt(what: str) -> Iterator[None]:
        """Note a test that its data refuse."""
        try:
            yield
        except InputError as error:
            refused.setdefault(str(error), []).append(what)

    for task in tasks_of(table):
        for metric in COMPARED:
            chosen, equal = _distinct(table.where(task=task), (metric,))
            same.setdefault(task, []).extend(equal)
            with attempt(f"{task} {metric}"):
                found.append(compare(chosen, metric, task=task, rng=rng))
                outcomes += [(task, each) for each in found[-1].tests]
        chosen, _ = _distinct(table.where(task=task), COMPARED)
        for factor in ("method", "group"):
            with attempt(f"{task} all metrics by {factor}"):
                if factor == "method" and len(methods_of(chosen)) < 2:
                    raise InputError(
                        "methods",
                        "differ in every metric",
                        "none that do",
                        "compare metrics one by one",
                    )
                outcomes.append((task, manova(chosen, COMPARED, factor=factor, rng=rng)))
    for metric in COMPARED:
        chosen, equal = _distinct(table, (metric,))
        same.setdefault("all", []).extend(equal)
        with attempt(f"{metric} over all tasks"):
            outcomes += [("all", each) for each in across_tasks(chosen, metric, rng=rng).tests]
    remarks = [f"{task}: {'; '.join(equal)}." for task, equal in same.items() if equal]
    remarks += list(dict.fromkeys(f"{task}: {each.note}" for task, each in outcomes if each.note))
    remarks += [f"{'; '.join(what)} could not be tested: {why}." for why, what in refused.items()]
    return [_outcomes(outcomes, remarks), _pairs(found), _assumptions(outcomes)]


def _distinct(table: TrialTable, metrics: Sequence[str]) -> tuple[TrialTable, list[str]]:
    """Return a task's trials without methods that give a metric of another's: there is no spread
    to test the two by.
    """
    kept: list[str] = []
    left_out = []
    for method in methods_of(table):
        same = [
            (other, metric)
            for other in kept
            for metric in metrics
            if _equal(table, metric, method, other)
        ]
        if same:
            left_out.append(
                f"{method} has the {same[0][1]} of {same[0][0]} in every trial and is left out"
            )
        else:
            kept.append(method)
    return table.where(method=kept), left_out


def _equal(table: TrialTable, metric: str, one: str, other: str) -> bool:
    """Return whether a metric is the same under two methods, to a thousandth of its spread."""
    first, second = (table.where(method=each).values(metric) for each in (one, other))
    both = np.isfinite(first) & np.isfinite(second)
    return bool((np.abs(first - second)[both] <= 1e-3 * first[both].std()).all())


def _outcomes(outcomes: list[tuple[str, HypothesisTest]], remarks: list[str]) -> Section:
    """List all tests, their p corrected over the family."""
    rows = tuple(
        (
            task,
            each.question,
            each.test,
            each.figures,
            format_p(p),
            "effect" if p < ALPHA else "none shown",
            str(each.effect or ""),
            "yes" if each.sound else "no",
            "; ".join(f"{other.test} {format_p(other.p)}" for other in each.alternatives),
        )
        for (task, each), p in zip(
            outcomes, corrected([each.p for _, each in outcomes], "bonferroni"), strict=True
        )
    )
    differing = [
        f"{task} {each.question}"
        for task, each in outcomes
        if any(o.found != each.found for o in each.alternatives)
    ]
    sentences = (
        f"{sum(row[5] == 'effect' for row in rows)} of {len(rows)} tests show an effect "
        "after Bonferroni's correction "
        "over all of them. The unit is the person, not the trial: a group has at most "
        f"{USERS} people, who meet every "
        "method, so that many trials alone do not make an effect.",
        f"An assumption is refused in {sum(row[7] == 'no' for row in rows)} of them; the "
        "tests in the last column rest "
        "on less."
        + (
            f" They do not all agree on {'; '.join(differing)}."
            if differing
            else " They all agree with the test."
        ),
        *remarks,
    )
    header = (
        "task",
        "question",
        "test",
        "figures",
        "p, Bonferroni",
        "shows",
        "size",
        "assumptions hold",
        "on less",
    )
    return Section("tests", "Tests", sentences, header, rows)


def _pairs(found: list[MetricComparison]) -> Section:
    """List all pairs of methods and groups by Tukey, and sizes of effects."""
    rows = [
        (
            each.task,
            pair.question,
            pair.figures,
            str(pair.effect or ""),
            "; ".join(o.figures for o in pair.alternatives),
        )
        for each in found
        for pair in each.pairs
    ]
    sizes = [
        (f"{each.task} {size.name.rsplit(', ', 1)[-1]}", size)
        for each in found
        if each.metric == "force_error"
        for size in each.sizes
    ]
    rows += [
        (
            name.split()[0],
            f"force_error: {name.split(' ', 1)[1]}",
            size.name.split(",")[0],
            str(size),
            "",
        )
        for name, size in sizes
    ]
    big = [f"{name} {size.value:+.1f}" for name, size in sizes if size.low * size.high > 0.0]
    sentences = (
        "Cohen's d of the force error whose interval leaves out zero: "
        + (", ".join(big) or "none")
        + ". Simulated people differ less than real ones, which makes a difference of one size "
        "look larger in standard "
        "deviations; the differences in percent above do not depend on that.",
    )
    header = ("task", "pair", "figures", "size", "beside it")
    return Section(
        "pairs", "Pairs and sizes of effects", sentences, header, tuple(rows), _sizes_picture(sizes)
    )


def _sizes_picture(sizes: list[tuple[str, Effect]]) -> bytes:
    """Draw Cohen's d with intervals, one a line, on a scale that holds large and small."""
    if not sizes:
        return b""
    figure, (axes,) = drawing(9.0, 0.24 * len(sizes) + 1.0)
    for line, (_, size) in enumerate(sizes):
        colour = "#0072B2" if size.low * size.high > 0.0 else "#999999"
        axes.plot([size.low, size.high], [line, line], color=colour, lw=1.5)
        axes.plot(size.value, line, "o", color=colour, ms=4)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(sizes)), [name for name, _ in sizes], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("Cohen's d of the force error, 95 % interval (linear within ±1)")
    return image(figure)


def _assumptions(outcomes: list[tuple[str, HypothesisTest]]) -> Section:
    """List the assumptions of every test."""
    rows = tuple(
        (task, each.question, check.name, "yes" if check.holds else "no", check.finding)
        for task, each in outcomes
        for check in each.assumptions
    )
    failed = Counter(row[2] for row in rows if row[3] == "no")
    failures = ", ".join(f"{name} {failed[name]}" for name in dict.fromkeys(row[2] for row in rows))
    return Section(
        "diagnostics",
        "Diagnostics",
        (
            (
                f"Checks that refused an assumption: {failures or 'none was made'}, of "
                f"{len(rows)} in all."
            ),
        ),
        ("task", "question", "assumption", "holds", "check"),
        rows,
    )


def composite_section(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report the composite index of each method and its weights."""
    index = composite_index(table, DIRECTIONS, rng=rng)
    rows = tuple(
        (
            what,
            each.name,
            f"{each.value:.3f}",
            f"{each.low:.3f}",
            f"{each.high:.3f}",
            str(COMPOSITE.get(each.name, "")) if what == "mean" else "",
        )
        for what, effects in (("weight", index.weights), ("mean", index.means))
        for each in effects
    )
    order = [each.name for each in sorted(index.means, key=lambda each: -each.value)]
    sentences = (
        index.sentence,
        f"By this index the order is {', '.join(order)}. The paper's 0.91 and 0.72 lie on a "
        "scale that its formula "
        "does not fix (metrics of mixed signs and units), so that only the order can be "
        "compared: there the "
        "perceptual method is best. "
        + ("So it is here." if order[0] == "koopman-perception" else f"Here it is {order[0]}."),
    )
    return sentences, ("what", "name", "value", "low", "high", "paper"), rows


def regression_section(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report the regression of task error on force error and latency: slopes by task."""
    rows = []
    remarks = []
    for task in tasks_of(table):
        found = trial_regression(
            table.where(task=task), "position_error_mm", ("force_error", "latency_ms")
        )
        remarks.append(f"{task}: {found.sentence}")
        for slope, chance in zip(found.slopes, found.chances, strict=True):
            figures = (
                f"{slope.value:.4g}",
                f"{slope.low:.4g}",
                f"{slope.high:.4g}",
                f"{chance:.3f}",
            )
            rows.append((task, slope.name, *figures))
    return (
        tuple(remarks),
        ("task", "slope", "median", "low", "high", "chance above zero"),
        tuple(rows),
    )


def power_section(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report the error rates of the tests with users drawn again 10,000 times, by task and test."""
    rows = []
    remarks = []
    loose = []
    for task in tasks_of(table):
        chosen, _ = _distinct(table.where(task=task), ("force_error",))
        for each in redrawn_power(chosen.cells("force_error"), rng=rng):
            remarks.append(f"{task}, {each.sentence}")
            if each.false_alarms.low > LOOSE:
                loose.append(f"{task} {each.test}")
            rates = (each.false_alarms.value, each.hits.value, 1.0 - each.hits.value)
            rows.append(
                (task, each.test, *(f"{100.0 * rate:.1f}" for rate in rates), str(each.populations))
            )
    if loose:
        remarks.append(
            f"More false alarms than {100.0 * LOOSE:.0f} % for {', '.join(loose)}: where the "
            "spread differs "
            "between groups or between pairs of methods, the usual F finds too much, and the "
            "tests that rest on "
            "less, in the last column of Tests, are the ones to trust."
        )
    return (
        tuple(remarks),
        ("task", "test", "type I %", "power %", "type II %", "populations"),
        tuple(rows),
    )
