"""Report sections of a study: hypothesis tests and other statistics.

Other statistics are effect sizes, a composite index, a regression and the power of the tests.
"""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from meshes.base.errors import InputError
from tissue.evaluation.statistics.comparison import (
    MetricComparison,
    across_tasks,
    compare,
    corrected,
    manova,
)
from tissue.evaluation.statistics.error_rates import Power, redrawn_power
from tissue.evaluation.statistics.hpi import composite_index
from tissue.evaluation.statistics.hypothesis_test import ALPHA, Effect, HypothesisTest, format_p
from tissue.evaluation.statistics.mixed import regression
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import COMPARED, DIRECTIONS, USERS
from tissue.evaluation.study.section import Section, drawing, image, methods_of, tasks_of

LOOSE = 0.06
"""Rate of false alarms above which a test with a level of 5 % is called too liberal.

For sign-flip tests, a rate of (5 ± 1) % is accepted in simulated studies
(`tests/bench/bench_null.py`).
"""
Outcome = tuple[str, HypothesisTest]
"""Hypothesis test with the name of its task ("all" for all tasks together)."""


def statistics_sections(table: TrialTable, rng: np.random.Generator) -> list[Section]:
    """Return the sections on statistics, or one section that explains why there are no tests."""
    try:
        sections = tests_sections(table, rng)
    except InputError as error:
        return [Section("tests", "Tests", (f"Nothing could be tested: {error}.",))]
    for name, title, make in (
        ("index", "Composite index", _composite),
        ("regression", "Task error against force error and latency", _regression),
        ("power", "Power and error rates", _power),
    ):
        try:
            sentences, rows = make(table, rng)
        except InputError as error:
            sentences = [f"This could not be tested: {error}."]
            rows = []
        sections.append(Section(name, title, sentences, rows))
    return sections


def tests_sections(table: TrialTable, rng: np.random.Generator) -> list[Section]:
    """Return the sections with the hypothesis tests of a study.

    Every metric is tested on every task, all metrics of a task are tested together, and every
    metric is tested over all tasks. The sections list the tests, the comparisons of pairs with
    effect sizes, and the assumptions.
    """
    found: list[MetricComparison] = []
    outcomes: list[Outcome] = []
    same: dict[str, list[str]] = {}
    refused: dict[str, list[str]] = {}

    def attempt(what: str, make: Callable[[], list[Outcome]]) -> None:
        """Add tests, or note the reason why the data do not allow them."""
        try:
            outcomes.extend(make())
        except InputError as error:
            refused.setdefault(str(error), []).append(what)

    def compared(task: str, metric: str) -> list[Outcome]:
        chosen, equal = _distinct(table.where(task=task), (metric,))
        same.setdefault(task, []).extend(equal)
        found.append(compare(chosen, metric, task=task, rng=rng))
        return [(task, each) for each in found[-1].tests]

    def together(task: str, factor: str) -> list[Outcome]:
        chosen, _ = _distinct(table.where(task=task), COMPARED)
        return [(task, manova(chosen, COMPARED, factor=factor, rng=rng))]

    def over_all(metric: str) -> list[Outcome]:
        chosen, equal = _distinct(table, (metric,))
        same.setdefault("all", []).extend(equal)
        return [("all", each) for each in across_tasks(chosen, metric, rng=rng)]

    for task in tasks_of(table):
        for metric in COMPARED:
            attempt(f"{task} {metric}", lambda: compared(task, metric))  # noqa: B023 called here
        for factor in ("method", "group"):
            attempt(f"{task} all metrics by {factor}", lambda: together(task, factor))  # noqa: B023
    for metric in COMPARED:
        attempt(f"{metric} over all tasks", lambda: over_all(metric))  # noqa: B023
    remarks = [f"{task}: {'; '.join(equal)}." for task, equal in same.items() if equal]
    remarks += list(dict.fromkeys(f"{task}: {each.note}" for task, each in outcomes if each.note))
    remarks += [f"{'; '.join(what)} could not be tested: {why}." for why, what in refused.items()]
    return [_outcomes(outcomes, remarks), _pairs(found), _assumptions(outcomes)]


def _distinct(table: TrialTable, metrics: Sequence[str]) -> tuple[TrialTable, list[str]]:
    """Return the trials without methods that have the same results as an earlier method.

    Two methods have the same results if a metric is equal in all trials; their difference cannot be
    tested. A sentence for each omitted method is returned too.
    """
    kept: list[str] = []
    left_out = []
    for method in methods_of(table):
        for other in kept:
            same = [metric for metric in metrics if _equal(table, metric, method, other)]
            if same:
                left_out.append(
                    f"{method} is left out, as its {same[0]} differs from that of {other} in no "
                    "trial by more than a thousandth of the standard deviation over trials"
                )
                break
        else:
            kept.append(method)
    return table.where(method=kept), left_out


def _equal(table: TrialTable, metric: str, one: str, other: str) -> bool:
    """Return whether two methods have the same metric in all trials."""
    first, second = (table.where(method=each).values(metric) for each in (one, other))
    both = np.isfinite(first) & np.isfinite(second)
    return bool((np.abs(first - second)[both] <= 1e-3 * first[both].std()).all())


def _outcomes(outcomes: Sequence[Outcome], remarks: Sequence[str]) -> Section:
    """List all tests, with p values that are corrected for the number of tests."""
    p_values = corrected([each.p for _, each in outcomes])
    rows = [
        {
            "task": task,
            "question": each.question,
            "test": each.test,
            "figures": each.figures,
            "p, Bonferroni": format_p(p),
            "shows": "effect" if p <= ALPHA else "none shown",
            "size": str(each.effect or ""),
            "assumptions hold": "yes" if each.sound else "no",
            "other tests": "; ".join(
                f"{other.test} {format_p(other.p)}" for other in each.alternatives
            ),
        }
        for (task, each), p in zip(outcomes, p_values, strict=True)
    ]
    differing = [
        f"{task} {each.question}"
        for task, each in outcomes
        if any(other.found != each.found for other in each.alternatives)
    ]
    agreement = "They all agree with the sign flips, each at 5 %"
    if differing:
        agreement = (
            f"At 5 % each, they do not all agree with the sign flips on {'; '.join(differing)}"
        )
    sentences = (
        f"{sum(row['shows'] == 'effect' for row in rows)} of {len(rows)} tests show an effect "
        "after Bonferroni's correction over all of them. The unit is the person, not the trial: a "
        f"group has at most {USERS} people, and every person uses every method. Many trials alone "
        "therefore do not make an effect.",
        "Sign flips decide: the largest t over all pairs of methods or groups, against the largest "
        "t after random changes of the sign of each person's differences or residuals. The last "
        "column has the tests of the paper (F, MANOVA, mixed model), which assume that methods and "
        f"groups have equal spread. {agreement}. The section Power and error "
        "rates has the measured rates of these tests.",
        "Partial eta squared is the effect's share of the variation in this sample. On average it "
        "is larger than the share in the population. Its 95 % interval is for the share in the "
        "population (noncentral F, Steiger 2004). The value can therefore lie above its interval.",
        f"The check of symmetry, which sign flips assume, fails in "
        f"{sum(not each.sound for _, each in outcomes)} of them.",
        *remarks,
    )
    return Section("tests", "Tests", sentences, rows)


def _pairs(found: Sequence[MetricComparison]) -> Section:
    """List sign-flip tests, Tukey's tests and effect sizes of all pairs."""
    rows = [
        {
            "task": each.task,
            "pair": pair.question,
            "figures": pair.figures,
            "size": str(pair.effect or ""),
            "Tukey": "; ".join(other.figures for other in pair.alternatives),
        }
        for each in found
        for pair in each.pairs
    ]
    sizes = []
    for each in found:
        found_pairs = [pair.question for pair in each.pairs if pair.found]
        for size in each.sizes if each.metric == "force_error" else ():
            name, pair_name = size.name.split(", ")
            question = f"force_error: {pair_name}"
            sizes.append((f"{each.task} {pair_name}", size, question in found_pairs))
            rows.append({"task": each.task, "pair": question, "figures": name, "size": str(size)})
    big = [f"{name} {size.value:+.1f}" for name, size, is_found in sizes if is_found]
    together = (
        "Pairs are decided by the same sign flips as their tests. Their p values and 95 % "
        "intervals hold for all pairs of a test together."
    )
    effects = [pair.effect for each in found for pair in each.pairs if pair.effect]
    if not all(np.isfinite(effect.high) for effect in effects):
        together += (
            " A pair without an interval has too few people. For methods, the smallest p value "
            "with n people is 2 / 2^n, which is 0.125 with 4 people. A 95 % interval therefore "
            "needs 6 people. For groups, 3 people in each group are enough."
        )
    sentences = (
        together,
        "Cohen's d of the force error for the pairs that differ at 5 % by these sign flips, "
        f"without correction for the number of tests: {', '.join(big) or 'none'}. Each interval of "
        "d holds for its pair alone, not for all pairs together. Simulated people differ less than "
        "real people, so the same difference is larger in standard deviations. The differences in "
        "percent above do not depend on that.",
    )
    picture = _sizes_picture(sizes) if sizes else b""
    return Section("pairs", "Pairs and sizes of effects", sentences, rows, picture)


def _sizes_picture(sizes: Sequence[tuple[str, Effect, bool]]) -> bytes:
    """Draw Cohen's d of each pair with its interval, one pair per line.

    `sizes` has the name of each pair, its d, and True if the test of the pair shows a difference.
    """
    # inches: 0.24 a line, and 1.4 for axis and label
    figure, (axes,) = drawing(9.0, 0.24 * len(sizes) + 1.4)
    # inches at the sides, so that no name of a pair touches the edge
    figure.set_layout_engine("constrained", w_pad=0.1)
    for line, (_, size, is_found) in enumerate(sizes):
        colour = "#0072B2" if is_found else "#999999"
        axes.plot([size.low, size.high], [line, line], color=colour)
        axes.plot(size.value, line, "o", color=colour)
    axes.axvline(0.0, color="black")
    # sizes reach from a fraction to tens of standard deviations, of both signs
    axes.set_xscale("symlog", linthresh=1.0)
    low = min(-1.0, *(size.low for _, size, _ in sizes))
    high = max(1.0, *(size.high for _, size, _ in sizes))
    # some space beyond the longest bar on an axis that is mostly logarithmic
    axes.set_xlim(1.5 * low, 1.5 * high)
    ticks = (-30, -10, -3, -1, 0, 1, 3, 10, 30)
    axes.set_xticks([tick for tick in ticks if 1.5 * low <= tick <= 1.5 * high])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(sizes)), [name for name, _, _ in sizes])
    axes.set_ylim(len(sizes) - 0.5, -0.5)
    axes.set_xlabel(
        "Cohen's d of the force error (linear within ±1), 95 % interval\n"
        "of each pair alone; blue: the test of the pair shows a difference at 5 %,\n"
        "without correction for the number of tests"
    )
    return image(figure)


def _assumptions(outcomes: Sequence[Outcome]) -> Section:
    """List the assumptions of every test."""
    rows = [
        {
            "task": task,
            "question": each.question,
            "test": test.test,
            "assumption": check.name,
            "holds": "yes" if check.holds else "no",
            "check": check.finding,
        }
        for task, each in outcomes
        for test in (each, *each.alternatives)
        for check in test.assumptions
    ]
    failed = Counter(row["assumption"] for row in rows if row["holds"] == "no")
    failures = ", ".join(f"{name} {count}" for name, count in failed.items()) or "none"
    sentence = f"Of {len(rows)} checks of assumptions, these failed: {failures}."
    return Section("diagnostics", "Diagnostics", (sentence,), rows)


Content = tuple[list[str], list[dict[str, str]]]
"""Content of a report section: sentences, and rows of a table."""


def _interval(effect: Effect, form: str) -> dict[str, str]:
    # z: no negative zero
    return {name: format(getattr(effect, name), f"z{form}") for name in ("value", "low", "high")}


def _composite(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report the composite index of each method, and the weights of the metrics."""
    index = composite_index(table, DIRECTIONS, rng=rng)
    rows = [
        {"what": "weight", "name": each.name} | _interval(each, ".3f") for each in index.weights
    ]
    rows += [{"what": "mean", "name": each.name} | _interval(each, ".3f") for each in index.means]
    sentences = [index.sentence]
    if len(index.means) < 2:
        return sentences, rows
    order = [each.name for each in sorted(index.means, key=lambda each: -each.value)]
    sentences.append(
        f"By this index the order is {', '.join(order)}. The paper's 0.91 and 0.72 lie on a scale "
        "that its formula does not fix (metrics of mixed signs and units), so only the order "
        "can be compared. In the paper, the perceptual method is best."
    )
    return sentences, rows


def _regression(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report, for each task, a regression of position error on force error and latency."""
    rows = []
    remarks = []
    for task in tasks_of(table):
        trials = table.where(task=task).complete()
        columns = {name: trials.values(name) for name in ("force_error", "latency_ms")}
        response = "position_error_mm"
        found = regression(trials.values(response), columns, trials.people(), response=response)
        remarks.append(f"{task}: {found.sentence}")
        for slope, chance in zip(found.slopes, found.chances, strict=True):
            row = {"task": task, "slope": slope.name} | _interval(slope, ".4g")
            rows.append(row | {"chance above zero": f"{chance:.3f}"})
    return remarks, rows


def _power(table: TrialTable, rng: np.random.Generator) -> Content:
    """Report error rates of the tests, estimated with resampled users, by task and question."""
    rows = []
    remarks = [
        "The table has the error rates of tests at 5 %, with people drawn again from this study, "
        "for the force error alone and for all metrics together. The rates of F are too high, "
        "because "
        "the covariance of the people of one study is never spherical: where the true rate is 5 %, "
        "the estimate is 6 % for methods and 7 % for group x method on average "
        "(python tests/bench/bench_null.py --only redrawn). The mixed model has the rates of F, "
        "which it equals in a complete design. For the regression and the composite index, "
        "python tests/bench/bench_null.py measures the rates on simulated studies."
    ]
    loose = []
    for task in tasks_of(table):
        trials = table.where(task=task)
        found: list[Power] = []
        for metrics in (COMPARED[:1], COMPARED):
            chosen, _ = _distinct(trials, metrics)
            found += redrawn_power([chosen.cells(metric) for metric in metrics], rng=rng)
        for each in found:
            if each.test == "sign flips":
                remarks.append(f"{task}, {each.sentence}")
            # the whole interval of the rate lies above
            if each.false_alarms.low > LOOSE:
                loose.append(f"{task} {each.question} by {each.test}")
            rows.append(
                {
                    "task": task,
                    "question": each.question,
                    "test": each.test,
                    "type I %": f"{100.0 * each.false_alarms.value:.1f}",
                    "power %": f"{100.0 * each.hits.value:.1f}",
                    "populations": str(each.populations),
                }
            )
    if loose:
        remarks.append(f"More false alarms than {100.0 * LOOSE:.0f} % for {', '.join(loose)}.")
    return remarks, rows
