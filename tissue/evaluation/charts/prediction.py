"""Comparison of force predictors on runs that were not used for training."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import write_rows
from tissue.evaluation.looks import looks
from tissue.evaluation.recorded_runs import Recorder, Recording, trial
from tissue.evaluation.statistics.intervals import Interval, mean_interval, signed_interval
from tissue.evaluation.training import HORIZONS, MOST_TRIALS, forecast_errors
from tissue.haptics.device.device import device_parameters
from tissue.prediction.predictor import Predictor, SeesContact
from tissue.prediction.trained import Trained, is_trained, shipped_file
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.show.figures.figure import figure, plain_numbers, save
from tissue.simulation.builders.prediction import trained_predictor
from tissue.system.owned_folder import OwnedFolder

FIRST_SEED = 10_000
"""First seed of the test runs. Training uses the seeds 0, 1, 2, ..."""
SHARES = (0.7, 1.3)
"""Factors on the tissue force in test runs, relative to the scene.

The test runs use the two factors in turn.
"""
OURS = "koopman-look-ahead"
DELAY_MS = 4
"""Latency of the haptic loop in the test runs [ms]; the published study has a mean of 4.3 ms."""


TABLES = ("errors.csv", "cost.csv")


@dataclass(frozen=True)
class PredictorComparison:
    """Errors and computing times of all predictors for one scene.

    Attributes
    ----------
    scene
        Name of the scene.
    errors
        Relative force errors, shape (runs, horizons), keyed by the name of the predictor.
    cost_us
        Median and 99th percentile of the computing time per tick [us], keyed by the name of the
        predictor.
    """

    scene: str
    errors: dict[str, Array]
    cost_us: dict[str, tuple[float, float]]

    def at(self, kind: str, horizon_ms: int) -> Interval:
        """Return the mean error of a predictor at a horizon [ms], with its 95 % interval."""
        return signed_interval(self.errors[kind][:, HORIZONS.index(horizon_ms)])


def _compare(
    scene: Scene, *, trials: int, file: Path | None, report: Progress
) -> PredictorComparison:
    """Measure all predictors on runs of a scene that were not used for training.

    Unlike the training runs, these runs have tissue that is 30 % softer or stiffer, and a fixed
    latency of 4 ms.

    Raises
    ------
    InputError
        If the scene has no trained predictor or cannot be run.
    """
    if file is None:
        file = Path(scene.predictor_file) if scene.predictor_file else shipped_file(scene.name)
    trained = Trained.read(file, scene=scene.name)
    device = device_parameters(trial(scene, 0).held.kind, scene.constants)
    limit_N = device.force_limit_N
    trained = trained.at_step(device.encoder_step_m)
    recorder = Recorder()
    steps = trials + len(PREDICTORS)
    unseen = []
    for index in range(trials):
        report(f"{scene.name}: unseen run {index + 1} of {trials}", index / steps)
        share = SHARES[index % len(SHARES)]
        unseen.append(
            recorder.record(trial(scene, FIRST_SEED + index, delay_ms=DELAY_MS, share=share))
        )
    errors = {}
    cost_us = {}
    for index, kind in enumerate(PREDICTORS, start=trials):
        report(f"{scene.name}: measuring {kind}", index / steps)
        make = partial(trained_predictor, kind, trained, force_limit_N=limit_N)
        errors[kind] = forecast_errors(make, unseen)
        cost_us[kind] = _cost_us(make(), unseen[0])
    return PredictorComparison(trained.scene, errors, cost_us)


def _cost_us(predictor: Predictor, run: Recording) -> tuple[float, float]:
    """Measure the median and 99th percentile of a predictor's computing time per tick [us].

    In each tick, the predictor observes the state and predicts the force `DELAY_MS` ahead.
    """
    # like the loop, this shows contacts only to predictors that use them
    shown = predictor if isinstance(predictor, SeesContact) else None
    times = []
    for position, velocity, force, contact in zip(
        run.position_m, run.velocity_m_s, run.force_N, run.contact, strict=True
    ):
        start = perf_counter()
        if shown is not None:
            shown.meet(contact)
        predictor.observe(position, velocity, force)
        predictor.predict(DELAY_MS)
        times.append(perf_counter() - start)
    return 1e6 * np.median(times), 1e6 * np.quantile(times, 0.99)


def predictable(scenes: Sequence[Scene], file: Path | None = None) -> tuple[list[Scene], list[str]]:
    """Return the scenes that have a trained predictor, and a note for each other scene.

    `file` is the file of a trained predictor for a single scene.

    Raises
    ------
    InputError
        If no scene has a trained predictor, or a file is given for several scenes.
    """
    if file is not None:
        if len(scenes) > 1:
            raise InputError(
                "--predictor-file",
                "be given with only one scene",
                f"{file} with the scenes {enumerated(scene.name for scene in scenes)}",
                "chart each scene alone",
            )
        return list(scenes), []
    able = [scene for scene in scenes if is_trained(scene.name, scene.predictor_file)]
    notes = [
        (
            f"{scene.name} is left out: no trained predictor. Train one with 'tissue train "
            f"{scene.name}', then run 'tissue chart prediction {scene.name} --predictor-file "
            f"{scene.name}.npz'."
        )
        for scene in scenes
        if scene not in able
    ]
    if not able:
        raise InputError(" ".join(notes))
    return able, notes


def chart_prediction(
    scenes: Sequence[Scene],
    folder: Path,
    *,
    trials: int,
    file: Path | None = None,
    overwrite: bool,
    report: Progress = silent,
) -> list[PredictorComparison]:
    """Compare the predictors on the given scenes; write pictures and tables into a folder.

    The pictures are ``prediction_SCENE.png`` and ``prediction_tasks.png``. `file` is the file of
    the trained predictor, for a single scene.

    Raises
    ------
    InputError
        If `trials` is below 2, a scene cannot be run, `folder` is a file, or `folder` contains a
        chart and `overwrite` is false.
    """
    # one run has no interval
    if not 2 <= trials <= MOST_TRIALS:
        raise InputError("trials", f"be from 2 to {MOST_TRIALS}", trials, "use a value such as 30")
    files = ("prediction_tasks.png", *TABLES, *(f"prediction_{scene.name}.png" for scene in scenes))
    found = []
    with OwnedFolder(folder, "chart", files, overwrite=overwrite):
        for index, scene in enumerate(scenes):
            onward = lambda doing, share, index=index: report(doing, (index + share) / len(scenes))  # noqa: E731
            found.append(_compare(scene, trials=trials, file=file, report=onward))
            # Each scene is written immediately: a chart takes half an hour, and a stopped chart
            # keeps the finished scenes.
            draw_scene(found[-1], folder / f"prediction_{scene.name}.png")
            draw_tasks(found, folder / "prediction_tasks.png")
            _write_comparisons(found, folder)
    return found


def comparison_lines(found: Sequence[PredictorComparison]) -> list[str]:
    """Describe the prediction errors at a horizon of 4 ms in words, and compare the predictors.

    The predictor `OURS` and every registered predictor are compared with zero-order hold and with
    the best of the remaining predictors. A predictor is called better or worse only if the 95 %
    interval of the paired difference excludes zero.
    """
    lines = [
        "error at 4 ms on unseen runs, % of the force, of each predictor with its guard "
        "(arithmetic mean over the runs, and its 95 % interval, computed for the logarithm of the "
        "mean)"
    ]
    for each in found:
        at_delay = {kind: each.at(kind, DELAY_MS) for kind in PREDICTORS}
        for kind, at in at_delay.items():
            lines.append(
                f"{each.scene:>12}  {kind:<18} {100 * at.mean:6.2f} ({100 * at.low:.2f} to "
                f"{100 * at.high:.2f})"
                f"   {each.cost_us[kind][0]:5.1f} µs"
            )
        own = [kind for kind in PREDICTORS if kind not in PREDICTORS.built_in]
        lines += [_verdict(each, kind, at_delay) for kind in (OURS, *own)]
    return lines


def _verdict(found: PredictorComparison, kind: str, at_delay: Mapping[str, Interval]) -> str:
    """Return the comparison of a predictor with zero-order hold and the best other predictor."""
    best = min((name for name in PREDICTORS if name != kind), key=lambda name: at_delay[name].mean)
    apart = mean_interval((found.errors[kind] - found.errors[best])[:, HORIZONS.index(DELAY_MS)])
    verdict = "not distinct from"
    if apart.high < 0.0:
        verdict = "better than"
    elif apart.low > 0.0:
        verdict = "worse than"
    ratio = at_delay[kind].mean / at_delay["hold"].mean
    return (
        f"{found.scene:>12}  {kind}: {ratio:.2f} times the error of hold. It is {verdict} the best "
        f"other predictor, {best}: the errors in the same run differ by {100 * apart.mean:+.2f} "
        f"({100 * apart.low:+.2f} to {100 * apart.high:+.2f})"
    )


def _write_comparisons(found: Sequence[PredictorComparison], folder: Path) -> None:
    """Write the tables of prediction errors and computing times.

    Errors are relative to the force. The columns ``low`` and ``high`` are the ends of the 95 %
    interval.
    """
    errors: list[Sequence[object]] = [
        ("scene", "predictor", "horizon_ms", "runs", "error", "low", "high")
    ]
    costs: list[Sequence[object]] = [("scene", "predictor", "median_us", "p99_us")]
    for each in found:
        for kind, runs in each.errors.items():
            errors += [(each.scene, kind, ms, len(runs), *each.at(kind, ms)) for ms in HORIZONS]
            costs.append((each.scene, kind, *each.cost_us[kind]))
    for name, rows in zip(TABLES, (errors, costs), strict=True):
        write_rows(folder / name, rows)


LIMIT_US = 20.0
"""Target for the median computing time of a predictor in a tick [us]."""


def draw_scene(found: PredictorComparison, path: Path) -> None:
    """Draw the results of all predictors for one scene.

    The left panel shows the error against the horizon; the right panel shows the error against the
    computing time.
    """
    # inches: a row of two panels over the legend
    chart = figure(8.5, 4.2)
    chart.set_layout_engine("constrained")
    over_horizon, over_cost = chart.subplots(1, 2)
    for kind in PREDICTORS:
        colour, mark = looks()[kind]
        mean, low, high = 100 * np.array([found.at(kind, each) for each in HORIZONS]).T
        over_horizon.plot(HORIZONS, mean, "-" + mark, color=colour, label=kind)
        over_horizon.fill_between(HORIZONS, low, high, color=colour, alpha=0.15)
        error = 100 * found.at(kind, DELAY_MS).mean
        median, p99 = found.cost_us[kind]
        over_cost.plot([median, p99], [error, error], color=colour, alpha=0.5)
        over_cost.plot(median, error, mark, color=colour)
    over_horizon.set(xlabel="horizon / ms", ylabel="force error / %", yscale="log")
    plain_numbers(over_horizon.yaxis)
    target = over_cost.axvline(LIMIT_US, color="0.3", linestyle="--")
    over_cost.set(xlabel="cost a tick / µs, median to 99 %", ylabel="force error 4 ms ahead / %")
    # 5 % of space above the largest error, so that its marker is not cut
    over_cost.set(xscale="log", ylim=(0, 1.05 * over_cost.dataLim.y1))
    plain_numbers(over_cost.xaxis)
    for axes in (over_horizon, over_cost):
        axes.grid(alpha=0.3, which="both")
    handles, labels = over_horizon.get_legend_handles_labels()
    chart.legend(
        [*handles, target],
        [*labels, f"target: {LIMIT_US:g} µs"],
        loc="outside lower center",
        # With five columns the width holds the longest built-in names in each.
        ncols=5,
        frameon=False,
    )
    chart.suptitle(
        f"{found.scene}: {len(found.errors['hold'])} runs with other seeds, in tissue 30 % softer "
        "and stiffer; bands: 95 % intervals",
    )
    save(chart, path)


def draw_tasks(found: Sequence[PredictorComparison], path: Path) -> None:
    """Draw the error of every predictor on every scene at a horizon of 4 ms."""
    # inches: 1.9 for the points of a scene, and at least the width of the legend
    chart = figure(max(1.9 * len(found) + 1.6, 6.0), 4.4)
    chart.set_layout_engine("constrained")
    axes = chart.subplots()
    # the points of a group take 0.7 of its unit, so that groups are apart
    width = 0.7 / len(PREDICTORS)
    places = np.arange(len(found)) - 0.35 + 0.5 * width
    for index, kind in enumerate(PREDICTORS):
        colour, mark = looks()[kind]
        mean, low, high = 100 * np.array([each.at(kind, DELAY_MS) for each in found]).T
        along = places + index * width
        axes.vlines(along, low, high, color=colour)
        axes.plot(along, mean, mark, color=colour, label=kind)
    label = "force error 4 ms ahead / %\nmean of the runs, 95 % interval"
    names = [each.scene for each in found]
    axes.set(xticks=range(len(found)), xticklabels=names, ylabel=label, yscale="log")
    plain_numbers(axes.yaxis)
    axes.grid(axis="y", which="both", alpha=0.3)
    chart.legend(loc="outside upper center", ncols=3, frameon=False)
    save(chart, path)
