"""Benchmark of the cost and the benefit of calibration.

Prints (1) the cost of a trial, next to questplus where that is installed (it is under the GPL: for
comparison only). (2) The number of trials until half of 300 thresholds lie within 10 % of the
truth, next to staircases. (3) Interval coverage, and the bias that heavy tails and fatigue cause.
(4) Discrimination with and without calibration on runs of the scenes, for 100 people a group, with
95 % intervals, next to the figures of the paper.

Run: python tests/bench/bench_calibration.py [trial] [staircase] [coverage] [scenes]
"""

import sys
from dataclasses import replace
from time import perf_counter

import numpy as np
from harness import cost_of, machine, table
from scipy.special import ndtri
from staircase import Staircase

from tissue.evaluation.calibration.observers import (
    SimulatedObservers,
    Stimulus,
    calibrated_commands,
    draw_observers,
    gain_of,
    share_right,
)
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.adaptive import AdaptiveThreshold, ThresholdPrior, comparisons
from tissue.perception.laws import D_PRIME_75, two_interval
from tissue.scene.registry import GROUPS
from tissue.simulation.trace import Table

PEOPLE = 100


def stimulus_of(trace: Table, start_s: float, end_s: float, *, scale: float = 1.0) -> Stimulus:
    """Return the stimulus at the device between two times of a run [s].

    It is the mean and the deviation of the force over windows.

    A window is as long as a person averages, a tenth of a second; slow changes of the force count
    as scatter.
    """
    window_s = constants("perception", "force")["integration_s"].value
    times, sizes = trace["time_s"], np.linalg.norm(trace.vectors("model_force", "N"), axis=1)
    edges = start_s + window_s * np.arange(int((end_s - start_s) / window_s + 1e-9) + 1)
    which = np.digitize(times, edges) - 1
    means = [
        scale * sizes[which == index].mean()
        for index in range(len(edges) - 1)
        if (which == index).any()
    ]
    return Stimulus(float(np.mean(means)), float(np.std(means)))


def equal_people(count: int, **given: float) -> SimulatedObservers:
    """People of the same truth."""
    truth = {"alpha": 1.0, "beta": 1.7, "kappa": 0.07, "offset_N": 0.2, "lapse": 0.02, "sigma": 0.2}
    noise = {name: given.pop(name) for name in ("freedom", "fatigue") if name in given}
    return SimulatedObservers(
        **{name: np.full(count, given.get(name, value)) for name, value in truth.items()}, **noise
    )


def calibrated(
    people: SimulatedObservers, trials: int, prior: ThresholdPrior | None = None
) -> AdaptiveThreshold:
    """Thresholds of people after some trials."""
    rng, found = np.random.default_rng(0), AdaptiveThreshold(prior, observers=len(people))
    for trial in range(trials):
        asked = found.propose()
        found.answer(
            asked, people.correct(found.base_N[asked], found.step_N[asked], rng, trial=trial)
        )
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
        errors["adaptive"].append(np.abs(np.log(found.threshold_N(2.0)[0] / truth)))
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
    """Coverage for people of a group, and bias under noise that the model does not know."""
    rows = []
    cases = {
        "as modelled": {},
        "heavy tails (t, 3)": {"freedom": 3.0},
        "fatigue 50 % in 100 trials": {"fatigue": 0.5},
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
    rows = []
    for prior in (
        ThresholdPrior(),
        ThresholdPrior(weber=0.2),
        ThresholdPrior(weber=0.04, weber_log_spread=0.3),
    ):
        found = calibrated(equal_people(400), 120, prior)
        rows.append(
            (
                f"{prior.weber:g}, {prior.weber_log_spread:g}",
                f"{100 * np.exp(np.log(found.weber()[0]).mean()):.2f}",
            )
        )
    print(table(rows, ("prior median, log spread", "mean / % (truth 7)")), end="\n\n")


def scene_stimuli() -> dict[str, tuple[Stimulus, Stimulus, str]]:
    """Return pairs of stimuli from runs of the scenes, and the figures of the paper for them.

    The stimuli are as their devices play them.
    """
    import tissue

    def ran(name: str, **overrides: object) -> tissue.Run:
        began = perf_counter()
        keys = {key.replace("__", "."): value for key, value in overrides.items()}
        run = tissue.simulate(tissue.load_scene(name, keys))
        print(f"ran {name} {keys} in {perf_counter() - began:.0f} s", file=sys.stderr)
        return run

    found = {}
    run = ran(
        "palpation",
        anatomy__touch_edge_mm=8.0,
        anatomy__nodule_centre_mm=[-40, 0, -20],
        motion__points_mm=[[0, 0, 2], [0, 0, -4], [26, 0, -4], [26, 0, 2]],
    )
    at = lambda kPa: 0.24 + ((kPa - 5.0) / 45.0 * 120.0 - 60.0) / 25.0  # noqa: E731  the slab's grading, the feed
    soft, hard = (stimulus_of(run.trace, at(kPa) - 0.15, at(kPa) + 0.16) for kPa in (30.0, 34.5))
    found["T1: 30 or 34.5 kPa"] = soft, hard, "+18 to 22 %"
    walls = [ran("wall", anatomy__stiffness_kN_m=stiffness).trace for stiffness in (10.0, 40.0)]
    found["T2: wall of 10 or 40 kN/m"] = (
        *(stimulus_of(each, 0.5, 1.11) for each in walls),
        "+18 to 22 %",
    )  # type: ignore
    bones = [
        ran("milling", voxels__spacing_mm=0.2, anatomy__density_kg_m3=density, duration_s=2.0).trace
        for density in (1800.0, 1650.0)
    ]
    found["T3: bone of 1.80 or 1.65 g/cm3"] = (
        *(stimulus_of(each, 0.3, 1.81, scale=0.03) for each in bones), "+18 to 22 %",
    )  # fmt: skip  # type: ignore
    run = ran("needle", duration_s=1.5)
    puncture = next(time for time, what in run.events if "capsule" in what)
    found["needle: capsule or parenchyma"] = (
        stimulus_of(run.trace, puncture - 0.102, puncture - 1e-3),
        stimulus_of(run.trace, puncture + 1e-3, puncture + 0.102),
        "error < 10 %",
    )
    run = ran(
        "caries",
        voxels__spacing_mm=0.1,
        stress__cell_mm=0.4,
        stress__interval_ms=2000.0,
        duration_s=2.0,
    )
    for scale in (0.1, 1.0):
        found[f"caries or dentin, force x {scale:g}"] = (
            stimulus_of(run.trace, 1.0, 1.21, scale=scale),
            stimulus_of(run.trace, 1.65, 1.86, scale=scale),
            "92 %",
        )
    run = ran("glenoid", voxels__spacing_mm=0.3)
    torques = np.linalg.norm(run.trace.vectors("model_torque", "Nm"), axis=1)
    for scale in (1.0, 0.03):
        level = scale * float(np.median(torques[torques > 0.01]))
        found[f"reaming: torque +0.08 N m, x {scale:g}"] = (
            Stimulus(level),
            Stimulus(level + scale * 0.08),
            "discriminated",
        )
    return found


def scenes() -> None:
    """Discrimination with and without calibration."""
    rows = []
    for name, (one, two, paper) in scene_stimuli().items():
        for group in GROUPS:
            rng = np.random.default_rng([1, GROUPS.index(group)])
            people = draw_observers(group, PEOPLE, rng)
            if "torque" in name:
                turning, usual = (constants("perception", each) for each in ("torque", "force"))
                people = replace(
                    people,
                    kappa=people.kappa * turning["kappa"].value / usual["kappa"].value,
                    offset_N=np.full(PEOPLE, turning["offset_Nm"].value),
                )
                right = share_right(people, one, two, seed=1, limits=ForceRange(limit_N=1e3))
                result = ("no map of torque", "")
            else:
                right = share_right(people, one, two, seed=1)
                commands = calibrated_commands(people, rng)
                scaled = share_right(people, one, two, seed=1, commands=commands)
                gain = gain_of(right, scaled, rng)
                result = (
                    f"{100 * scaled.mean():.1f}",
                    f"{gain.value:+.1f} ({gain.low:+.1f} to {gain.high:+.1f})",
                )
            error = 196.0 * right.std() / len(right) ** 0.5
            levels = f"{one.level_N:.3f}, {two.level_N:.3f}"
            rows.append(
                (name, levels, group, f"{100 * right.mean():.1f} ± {error:.1f}", *result, paper)
            )
    head = (
        "stimuli",
        "levels / N or N m",
        "group",
        "right / %",
        "calibrated / %",
        "change / %",
        "paper",
    )
    print(table(rows, head))


if __name__ == "__main__":
    print(machine(), end="\n\n")
    for part in (trial, staircase, coverage, scenes):
        if len(sys.argv) == 1 or part.__name__ in sys.argv[1:]:
            part()
