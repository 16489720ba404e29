"""Benchmark of the cost and the benefit of calibration.

Prints (1) the cost of a trial, next to questplus where that is installed (it is under the GPL: for
comparison only). (2) The number of trials until half of 300 thresholds lie within 10 % of the
truth, next to staircases. (3) Interval coverage, and the bias that other rates of lapses cause.

Run: python tests/bench/bench_calibration.py [trial] [staircase] [coverage]
"""

import sys

import numpy as np
from harness import cost_of, machine, table
from scipy.special import ndtri
from staircase import Staircase

from tissue.evaluation.calibration.observers import SimulatedObservers, draw_observers
from tissue.perception.adaptive import AdaptiveThreshold, ThresholdPrior, comparisons
from tissue.perception.laws import D_PRIME_75, two_interval


def equal_people(count: int, **given: float) -> SimulatedObservers:
    """People of the same truth."""
    truth = {"alpha": 1.0, "beta": 1.7, "kappa": 0.07, "offset_N": 0.2, "lapse": 0.02, "sigma": 0.2}
    return SimulatedObservers(
        **{name: np.full(count, given.get(name, value)) for name, value in truth.items()}
    )


def calibrated(people: SimulatedObservers, trials: int) -> AdaptiveThreshold:
    """Thresholds of people after some trials."""
    rng, found = np.random.default_rng(0), AdaptiveThreshold(observers=len(people))
    for _ in range(trials):
        asked = found.propose()
        found.answer(asked, people.correct(found.base_N[asked], found.step_N[asked], rng))
    return found


def trial() -> None:
    """Cost of a trial on a grid of 50 stimuli and 2,400 parameters."""
    prior = ThresholdPrior(cells=60, offset_cells=8, lapse_cells=5)
    ours = AdaptiveThreshold(prior, (np.ones(50), 1.2 * np.geomspace(0.005, 1.5, 50)))
    rng = np.random.default_rng(0)

    def one(_: int) -> None:
        asked = ours.propose()
        ours.answer(asked, rng.random(1) < two_interval(1.0, ours.step_N[asked], 0.07, 0.2, 0.02))

    rows = [("tissue", f"{len(ours.step_N)} x {len(ours.posterior)}", str(cost_of(one, count=300)))]
    try:
        from questplus import QuestPlus
    except ImportError:
        print("questplus is not installed: no peer")
    else:
        peer = QuestPlus(
            stim_domain={"intensity": np.log10(ours.step_N)},
            param_domain={
                "threshold": np.log10(prior.webers * 1.2),
                "slope": np.linspace(1.0, 5.0, 8),
                "lower_asymptote": np.array([0.5]),
                "lapse_rate": np.unique(prior.parameters()[2]),
            },
            outcome_domain={"response": ["Yes", "No"]},
            func="weibull",
            stim_scale="log10",
            stim_selection_method="min_entropy",
            param_estimation_method="mean",
        )

        def other(_: int) -> None:
            stimulus = peer.next_stim
            right = rng.random() < two_interval(1.0, 10.0 ** stimulus["intensity"], 0.07, 0.2, 0.02)
            peer.update(stim=stimulus, outcome={"response": "Yes" if right else "No"})

        rows.append(
            ("questplus", f"{len(ours.step_N)} x 2400", str(cost_of(other, count=60, warm_up=10)))
        )
    print(table(rows, ("trial", "grid", "median, p99, max / us")), end="\n\n")


def staircase() -> None:
    """Trials until half of the thresholds at 2 N lie within 10 %, for good."""
    rng, count, trials = np.random.default_rng(6), 300, 500
    people = draw_observers("intermediate", count, rng)
    truth = people.kappa * (2.0 + people.offset_N)
    found = AdaptiveThreshold(ThresholdPrior(offset_cells=1), comparisons((2.0,)), observers=count)
    stairs = {f"1-up-{down}-down": Staircase(0.6, down=down, observers=count) for down in (2, 3)}
    errors: dict[str, list[np.ndarray]] = {"adaptive": [], **{name: [] for name in stairs}}
    for _ in range(trials):
        asked = found.propose()
        found.answer(asked, people.correct(2.0, found.step_N[asked], rng))
        errors["adaptive"].append(
            np.abs(np.log(found.weber()[0] * (2.0 + found.offset_N()) / truth))
        )
        for name, each in stairs.items():
            each.answer(people.correct(2.0, each.level, rng))
            result = each.threshold() * D_PRIME_75 / (2.0**0.5 * ndtri(each.target))
            errors[name].append(np.abs(np.log(result / truth)))
    needed = {}
    for name, each in errors.items():
        beyond = np.median(each, axis=1)[::-1] > np.log(1.1)
        needed[name] = trials - int(np.argmax(beyond))
    rows = [
        (
            name,
            f"{needed[name]}" if needed[name] < trials else f"more than {trials}",
            f"{needed['adaptive'] / needed[name]:.2f}",
            *(f"{100 * np.median(each[at - 1]):.0f}" for at in (30, 60, 120, 240)),
        )
        for name, each in errors.items()
    ]
    print(
        table(
            rows,
            ("method", "trials to 10 %", "ratio", "median error / % at 30", "60", "120", "240"),
        ),
        end="\n\n",
    )


def coverage() -> None:
    """Coverage for people of a group, and bias under other rates of lapses."""
    rows = []
    cases = {
        "as modelled": {},
        "no lapses": {"lapse": 0.0},
        "lapse 6 %": {"lapse": 0.06},
        "lapse 10 %": {"lapse": 0.1},
    }
    for name, wrong in cases.items():
        found = calibrated(equal_people(400, **wrong), 120)
        low, high = found.weber_quantiles(np.array([0.025, 0.975]))
        weber_fraction = found.weber()[0]
        rows.append(
            (
                name,
                f"{100 * np.exp(np.log(weber_fraction).mean()):.2f}",
                f"{100 * np.log(weber_fraction).std():.0f}",
                f"{100 * np.mean((low < 0.07) & (high > 0.07)):.1f}",
            )
        )
    print(
        table(
            rows,
            ("truth 7 %, 400 people, 120 trials", "mean / %", "scatter / %", "95 % covers / %"),
        ),
        end="\n\n",
    )


if __name__ == "__main__":
    print(machine(), end="\n\n")
    for part in (trial, staircase, coverage):
        if len(sys.argv) == 1 or part.__name__ in sys.argv[1:]:
            part()
