"""False alarms and found effects of the tests of a study, over simulated studies.

Run: `python tests/bench/bench_null.py [--quick] [--only PART]`, where PART is deciding, mixed,
regression, index or redrawn.

A study has three groups of ten people under five methods. `deciding` tests 4,000 studies of each
world by sign flips, which decide, and by F, Greenhouse and Geisser's correction, Tukey and MANOVA.
The worlds differ in the spreads of methods and groups. `T2` has the means, spreads and correlation
of the force errors of 30 trials of T2, with one trial or ten of each person. The planted effect is
one standard deviation: of the difference between methods 3 and 4, or of people's means. In T2,
methods 3 and 4 are the ones with look-ahead and with perception.

`redrawn` compares the rates of a report with known ones. It draws 25 normal studies with equal
spreads, in which every test has 5 % of false alarms. It prints the mean and the range over studies
of the estimates with redrawn people, with noise (as in the report) and without.

The other three parts measure the paper's Bayesian regression and composite index over 2,000 studies
without an effect, and its mixed model over 200, as a fit takes 1 to 2 s. An index rejects if the
interval of any method excludes zero, a regression if the interval of a slope does. Printed with
each rate: its binomial standard error.
"""

import argparse
from collections.abc import Callable

import numpy as np
from harness import machine, table

from tissue.evaluation.statistics.error_rates import (
    POPULATIONS,
    QUESTIONS,
    Power,
    redrawn_power,
    rejection_rates,
)
from tissue.evaluation.statistics.hpi import composite_index, drawn_users
from tissue.evaluation.statistics.hypothesis_test import ALPHA
from tissue.evaluation.statistics.mixed import mixed_model, regression
from tissue.evaluation.statistics.strata import group_means, strata
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import DIRECTIONS, METHODS

PEOPLE = 10
GROUPS = np.repeat([0, 1, 2], PEOPLE)
NAMES = tuple(METHODS)[:5]
"""Names of the five methods of the simulated studies."""
METHOD_SPREADS = np.array([1.0, 2.0, 0.3, 0.15, 0.3])
GROUP_SPREADS = np.array([2.0, 1.0, 0.5])[GROUPS][:, None]
T2_MEANS = np.array([0.083, 0.013, 0.006, 0.013, 0.038])
"""Force errors of energy, koopman, koopman-look-ahead, koopman-perception and penalty."""
T2_SPREADS = np.array([0.19, 0.15, 0.31])[GROUPS][:, None]
"""Standard deviation of the logarithm of force errors of experts, intermediates and novices."""
T2_CORRELATION = 0.7
"""Correlation of the logarithms between methods, within groups."""
METRICS = 3
"""Number of metrics that are tested together, with a correlation of 0.5."""

World = Callable[[np.random.Generator, int], np.ndarray]


def normal(spreads: np.ndarray | float) -> World:
    """A world of normal values of people under methods."""
    return lambda rng, count: rng.standard_normal((count, len(GROUPS), 5)) * spreads


def lognormal(spread: np.ndarray | float, correlation: float, trials: int = 1) -> World:
    """A world of positive errors with a standard deviation of their logarithm; the mean is zero.

    With several trials, half of the variance of a trial is between people.
    """

    def logarithms(rng: np.random.Generator, count: int) -> np.ndarray:
        shared = rng.standard_normal((count, len(GROUPS), 1))
        single = rng.standard_normal((count, len(GROUPS), 5))
        return spread * (correlation**0.5 * shared + (1.0 - correlation) ** 0.5 * single)

    def draw(rng: np.random.Generator, count: int) -> np.ndarray:
        centre = np.exp(0.5 * np.asarray(spread) ** 2)
        if trials == 1:
            return np.exp(logarithms(rng, count)) - centre
        person = 0.5**0.5 * logarithms(rng, count)
        total = np.zeros_like(person)
        for _ in range(trials):
            total += np.exp(person + 0.5**0.5 * logarithms(rng, count))
        return total / trials - centre

    return draw


def scaled(world: World, scale: np.ndarray) -> World:
    """A world with other units of each method."""
    return lambda rng, count: world(rng, count) * scale


WORLDS: dict[str, World] = {
    "equal spreads": normal(1.0),
    "methods 1, 2, 0.3, 0.15, 0.3": normal(METHOD_SPREADS),
    "groups 2, 1, 0.5": normal(GROUP_SPREADS),
    "both": normal(METHOD_SPREADS * GROUP_SPREADS),
    "T2, one trial": scaled(lognormal(T2_SPREADS, T2_CORRELATION), T2_MEANS),
    "T2, ten trials": scaled(lognormal(T2_SPREADS, T2_CORRELATION, 10), T2_MEANS),
    "both, skewness 1.7": scaled(lognormal(0.5, 0.0), METHOD_SPREADS * GROUP_SPREADS),
}
"""Studies without an effect. The last one is outside of what a study gives."""


def effects(null: np.ndarray) -> dict[str, np.ndarray]:
    """Effects of one standard deviation, by question, each of shape (people, methods)."""
    method = np.zeros((len(GROUPS), 5))
    method[:, 2] = (null[..., 2] - null[..., 3]).std()
    group = np.zeros_like(method)
    group[GROUPS == 1] = null.mean(axis=-1).std()
    both = method.copy()
    both[GROUPS != 1] = 0.0
    return {"method": method, "group": group, "group x method": both}


def percent(share: float, count: int) -> str:
    """A rate with its binomial standard error."""
    error = (share * (1.0 - share) / count) ** 0.5
    return f"{100.0 * share:.1f} ± {100.0 * error:.1f}"


def row_of(world: str, rates: Power) -> tuple[str, ...]:
    """Row of the printed table."""
    shares = (rates.false_alarms.value, rates.hits.value)
    printed = (percent(each, rates.populations) for each in shares)
    return (world, rates.question, rates.test, *printed)


def deciding(rng: np.random.Generator, count: int) -> list[tuple[str, ...]]:
    """Rates of the deciding tests and of the ones that go with them."""
    rows = []
    for name, world in WORLDS.items():
        null = world(rng, count)
        for question, effect in effects(null).items():
            found = rejection_rates(
                null[:, None], (null + effect)[:, None], GROUPS, rng=rng, questions=[question]
            )
            rows += [row_of(name, each) for each in found]
        # metrics share half of their variance
        shared = world(rng, count)
        metrics = np.stack([shared + world(rng, count) for _ in range(METRICS)], axis=1)
        shifts = effects(metrics[:, 0])
        for question in ("method", "group"):
            planted = metrics.copy()
            planted[:, 0] += shifts[question]
            found = rejection_rates(metrics, planted, GROUPS, rng=rng, questions=[question])
            rows += [row_of(name, each) for each in found]
    return rows


def redrawn(rng: np.random.Generator, count: int) -> list[tuple[str, ...]]:
    """Estimated rates of false alarms with people redrawn from one study, over studies."""
    estimates: dict[tuple[str, ...], list[float]] = {}
    for _ in range(count):
        cells = trials_of(rng, ["error"], 2, np.ones(5)).cells("error")
        residuals = cells.values - group_means(cells.values, cells.groups)[cells.groups]
        # a drawn residual has the variance (n - 1) / n of the unbiased one
        residuals *= (PEOPLE / (PEOPLE - 1.0)) ** 0.5
        null = residuals[drawn_users(cells.groups, POPULATIONS, rng)]
        for kind, rates in (
            ("redrawn with noise", redrawn_power([cells], rng=rng)),
            (
                "redrawn without noise",
                rejection_rates(null[:, None], null[:, None], GROUPS, rng=rng),
            ),
        ):
            for each in rates:
                label = (kind, each.question, each.test)
                estimates.setdefault(label, []).append(100.0 * each.false_alarms.value)
    return [
        (*label, f"{np.mean(found):.1f} ({min(found):.1f} to {max(found):.1f})", "")
        for label, found in estimates.items()
    ]


def trials_of(
    rng: np.random.Generator, names: list[str], trials: int, spreads: np.ndarray
) -> TrialTable:
    """Trials of one task without an effect: people, people by method, and trials vary."""
    shape = (len(GROUPS), trials, len(NAMES))
    person, trial, method = (each.ravel() for each in np.indices(shape))
    metrics = {}
    for name in names:
        user = rng.standard_normal((len(GROUPS), 1, 1))
        taste = 0.5 * rng.standard_normal((len(GROUPS), 1, len(NAMES))) * spreads
        rest = rng.standard_normal(shape) * spreads
        metrics[name] = (user + taste + rest).ravel()
    return TrialTable(
        task=np.full(person.shape, "T2"),
        group=np.array(["expert", "intermediate", "novice"])[GROUPS[person]],
        user=(person % PEOPLE).astype(str),
        trial=trial,
        method=np.array(NAMES)[method],
        seed=np.zeros(person.shape, dtype=np.int64),
        failure=np.full(person.shape, ""),
        metrics=metrics,
    )


def mixed(rng: np.random.Generator, count: int) -> list[tuple[str, ...]]:
    """Rates of the mixed model and of F in the same studies, methods of unequal spreads."""
    alarms: dict[tuple[str, str], int] = {}
    for _ in range(count):
        trials = trials_of(rng, ["error"], 2, METHOD_SPREADS)
        cells = trials.cells("error")
        for test in mixed_model(trials, "error"):
            question = test.question.removeprefix("error: ")
            chosen, between = QUESTIONS[question]
            exact = strata(cells.values, cells.groups, cells.sizes, chosen, between=between)
            for name, p in (("mixed model", test.p), ("F of strata", float(exact.p))):
                label = (question, name)
                alarms[label] = alarms.get(label, 0) + (p <= ALPHA)
    return [
        ("methods unequal", question, name, percent(found / count, count), "")
        for (question, name), found in alarms.items()
    ]


def slopes(rng: np.random.Generator, count: int) -> list[tuple[str, ...]]:
    """Rates of the Bayesian regression of one metric on two others that are independent of it."""
    names = ["position_error_mm", "force_error", "latency_ms"]
    alarms = np.zeros(2)
    for _ in range(count):
        trials = trials_of(rng, names, 2, np.ones(5))
        response, *predictors = (trials.values(name) for name in names)
        columns = dict(zip(names[1:], predictors, strict=True))
        found = regression(response, columns, trials.people(), response=names[0])
        alarms += [each.low * each.high > 0.0 for each in found.slopes]
    return [
        ("equal spreads", name, "Bayesian regression", percent(each / count, count), "")
        for name, each in zip(names[1:], alarms, strict=True)
    ]


def index(rng: np.random.Generator, count: int) -> list[tuple[str, ...]]:
    """Rates of the composite index: intervals of methods that exclude zero."""
    rows = []
    for world, spreads in (("equal spreads", np.ones(5)), ("methods unequal", METHOD_SPREADS)):
        alarms = []
        for _ in range(count):
            trials = trials_of(rng, list(DIRECTIONS), 2, spreads)
            # 200 resampled studies know an end to a seventh of its distance
            found = composite_index(trials, DIRECTIONS, rng=rng, count=200)
            alarms.append([each.low * each.high > 0.0 for each in found.means])
        for question, share in (
            ("any method", np.any(alarms, axis=1).mean()),
            ("one method", np.mean(alarms)),
        ):
            rows.append((world, question, "composite index", percent(float(share), count), ""))
    return rows


PARTS = {
    "deciding": (deciding, 4000),
    "mixed": (mixed, 200),
    "regression": (slopes, 2000),
    "index": (index, 2000),
    "redrawn": (redrawn, 25),
}
"""Parts with their numbers of studies."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a hundredth of the studies")
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument("--seed", type=int, default=0, help="seed of the studies")
    given = parser.parse_args()
    print(machine())
    for name, (measure, count) in PARTS.items():
        if given.only in (None, name):
            studies = max(1, count // 100) if given.quick else count
            rows = measure(np.random.default_rng([given.seed, list(PARTS).index(name)]), studies)
            print(f"\n{name}: {studies} studies, false alarms and found effects at 5 %, %")
            print(table(rows, ("world", "question", "test", "false alarms", "found")), flush=True)


if __name__ == "__main__":
    main()
