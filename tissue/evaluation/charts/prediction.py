"""All predictors against each other on runs they have not seen: horizon, cost, training size, slow models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.builders.prediction import trained_predictor
from tissue.evaluation.charts.prediction_picture import draw_scene, draw_tasks
from tissue.evaluation.training.evaluation import HORIZONS, forecast_errors
from tissue.evaluation.training.fitting import fit
from tissue.evaluation.training.recording import Recorder, Recording, trial
from tissue.evaluation.training.train import MOST_TRIALS
from tissue.haptics.device.device import device_parameters
from tissue.prediction.contact import Contact, SeesContact
from tissue.prediction.predictor import Predictor
from tissue.prediction.trained import Trained, is_trained, shipped_file
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.system.owned_folder import owned_folder

__all__ = [
    "OURS",
    "Interval",
    "PredictorComparison",
    "chart_prediction",
    "compare",
    "comparison_lines",
    "interval",
    "predictable",
]

FIRST_SEED = 10_000
"""Seeds of unseen runs begin here; training uses those from 0 on."""
SHARES = (0.7, 1.3)
"""Force of the tissue of unseen runs over that of training, in turn."""
OURS = "koopman-look-ahead"
DELAY_MS = 4
SLOW_TICKS = 10
SIZES = (3, 6, 12)
"""Runs to train on."""
SIZED_RUNS = 8
"""Unseen runs by which training sizes are compared."""
FILES = ("prediction_tasks.png", "errors.csv", "cost.csv", "spectrum.csv", "training.csv", "slow_model.csv")
HEADS = {
    "errors.csv": "scene,predictor,horizon_ms,runs,error,low,high",
    "cost.csv": "scene,predictor,median_us,p99_us",
    "spectrum.csv": "scene,real,imaginary,size",
    "training.csv": "scene,runs,error,low,high",
    "slow_model.csv": "scene,predictor,error,low,high,cost_us",
}


@dataclass(frozen=True)
class Interval:
    """Mean over runs and its 95 % interval by Student's t."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class PredictorComparison:
    """What was measured on a scene.

    Attributes
    ----------
    scene
        Its name.
    errors
        Errors by predictor, shape (runs, horizons).
    cost_us
        Median and 99th percentile of a tick's call [us], by predictor.
    eigenvalues
        Of the lifted operator.
    sizes
        Runs trained on, and the error at 4 ms that followed.
    slow
        Of a model at 100 Hz with a predictor between its answers, by predictor, the error of the force of the present
        tick and the cost a tick [us]; with ``1 kHz`` those of the model in every tick.
    """

    scene: str
    errors: dict[str, Array]
    cost_us: dict[str, tuple[float, float]]
    eigenvalues: NDArray[np.complex128]
    sizes: dict[int, Interval]
    slow: dict[str, tuple[Interval, float]]

    def at(self, kind: str, horizon_ms: int) -> Interval:
        """Error of a predictor at a horizon."""
        return interval(self.errors[kind][:, HORIZONS.index(horizon_ms)])


def interval(values: Array) -> Interval:
    """Mean over the first axis of independent runs with its interval; without width for a single run."""
    from scipy.stats import t

    mean, count = float(values.mean()), len(values)
    half = float(t.ppf(0.975, count - 1) * values.std(ddof=1) / np.sqrt(count)) if count > 1 else 0.0
    return Interval(mean, mean - half, mean + half)


def compare(scene: Scene, *, trials: int, report: Progress = silent) -> PredictorComparison:
    """Measure all predictors on unseen runs of a scene: other seeds, tissue 30 % softer and stiffer, 4 ms of latency.

    Raises
    ------
    InputError
        If the scene has no trained predictor or cannot be run.
    """
    file = scene.predictor_file
    trained = Trained.read(Path(file) if file else shipped_file(scene.name), scene=scene.name)
    limit = device_parameters(trial(scene, 0).held.kind, scene.constants).force_limit_N
    recorder, unseen, seen = Recorder(), [], []
    steps = trials + max(SIZES) + 4
    for index in range(trials):
        report(f"{scene.name}: unseen run {index + 1} of {trials}", index / steps)
        share = SHARES[index % len(SHARES)]
        unseen.append(recorder.record(trial(scene, FIRST_SEED + index, delay_ms=DELAY_MS, share=share)))
    for index in range(max(SIZES)):
        report(f"{scene.name}: training run {index + 1}", (trials + index) / steps)
        seen.append(recorder.record(trial(scene, index)))

    def report_measuring(doing: str, share: float) -> None:
        report(f"{scene.name}: {doing}", (trials + max(SIZES) + (steps - trials - max(SIZES)) * share) / steps)

    return measured(trained, unseen, seen, force_limit_N=limit, report=report_measuring)


def measured(
    trained: Trained,
    unseen: Sequence[Recording],
    seen: Sequence[Recording],
    *,
    force_limit_N: float,
    report: Progress = silent,
) -> PredictorComparison:
    """Measure predictors on recorded runs; others train those for the training sizes."""
    sizes_done = [size for size in SIZES if size <= len(seen)]
    total = 2 * len(PREDICTORS) + len(sizes_done)
    done = 0

    def step(doing: str) -> None:
        nonlocal done
        report(doing, done / total)
        done += 1

    def maker(kind: str, of: Trained = trained) -> Callable[[], Predictor]:
        return lambda: trained_predictor(kind, of, force_limit_N=force_limit_N)

    errors = {}
    for kind in PREDICTORS:
        step(f"measuring {kind}")
        errors[kind] = forecast_errors(maker(kind), unseen)
    cost_us = {kind: _cost_us(maker(kind), unseen[0]) for kind in PREDICTORS}
    sizes = {}
    for size in sizes_done:
        step(f"training on {size} runs")
        fitted = fit(trained.scene, seen[:size])
        smaller = replace(trained, operator=fitted.operator, growth=fitted.growth)
        found = forecast_errors(maker(OURS, smaller), unseen[:SIZED_RUNS], horizons=(DELAY_MS,))
        sizes[size] = interval(found[:, 0])
    model_us = 1e6 * float(np.median([run.model_s for run in unseen]))
    slow = {"1 kHz": (Interval(0.0, 0.0, 0.0), model_us)}
    for kind in PREDICTORS:
        step(f"measuring {kind} with a slow model")
        found = forecast_errors(maker(kind), unseen, horizons=(0,), model_ticks=SLOW_TICKS)
        slow[kind] = (interval(found[:, 0]), model_us / SLOW_TICKS + cost_us[kind][0])
    return PredictorComparison(trained.scene, errors, cost_us, trained.operator.eigenvalues, sizes, slow)


def _cost_us(make: Callable[[], Predictor], run: Recording) -> tuple[float, float]:
    """Median and 99th percentile of observing a tick and predicting the force after the latency [us]."""
    predictor = make()
    shown = predictor if isinstance(predictor, SeesContact) else None
    times = []
    for position, velocity, force, row in zip(run.position_m, run.velocity_m_s, run.force_N, run.contact, strict=True):
        contact = Contact.of_row(row)
        start = perf_counter()
        if shown is not None:
            shown.meet(contact)
        predictor.observe(position, velocity, force)
        predictor.predict(DELAY_MS)
        times.append(perf_counter() - start)
    return 1e6 * float(np.median(times)), 1e6 * float(np.quantile(times, 0.99))


def predictable(scenes: Sequence[Scene]) -> tuple[list[Scene], list[str]]:
    """Return the scenes that have a trained predictor, and a note for each of the others.

    Raises
    ------
    InputError
        If no scene has one.
    """
    able = [scene for scene in scenes if is_trained(scene.name, scene.predictor_file)]
    notes = [
        f"{scene.name} is left out: no trained predictor. Train one with 'tissue train {scene.name}'."
        for scene in scenes
        if scene not in able
    ]
    if not able:
        raise InputError(" ".join(notes))
    return able, notes


def chart_prediction(
    scenes: Sequence[Scene], folder: Path, *, trials: int, overwrite: bool, report: Progress = silent
) -> list[PredictorComparison]:
    """Measure and draw some scenes: ``prediction_SCENE.png``, ``prediction_tasks.png`` and tables.

    Raises
    ------
    InputError
        If the folder is a file or holds another chart, there are fewer than two trials, or a scene cannot be used.
    """
    if not 2 <= trials <= MOST_TRIALS:
        raise InputError(f"trials must be from 2 to {MOST_TRIALS}, got {trials}: use 30")
    files = (*FILES, *(f"prediction_{scene.name}.png" for scene in scenes))
    found = []
    with owned_folder(folder, "chart", files, overwrite=overwrite):
        for index, scene in enumerate(scenes):
            onward = lambda doing, share, index=index: report(doing, (index + share) / len(scenes))  # noqa: E731
            found.append(compare(scene, trials=trials, report=onward))
            # At once: a chart takes half an hour, and one that is stopped keeps the scenes that are done.
            draw_scene(found[-1], folder / f"prediction_{scene.name}.png")
            draw_tasks(found, folder / "prediction_tasks.png")
            _write_comparisons(found, folder)
    return found


def comparison_lines(found: Sequence[PredictorComparison]) -> list[str]:
    """What a person reads: errors at 4 ms, and how ours compares to hold and to the best other.

    It is called better or worse only where the interval of the paired difference over runs excludes zero.
    """
    lines = ["error at 4 ms on unseen runs, % of the force (mean and 95 % interval)"]
    for each in found:
        for kind in PREDICTORS:
            at = each.at(kind, DELAY_MS)
            lines.append(
                f"{each.scene:>12}  {kind:<18} {100 * at.mean:6.2f} ({100 * at.low:.2f} to {100 * at.high:.2f})"
                f"   {each.cost_us[kind][0]:5.1f} µs"
            )
        ours, held = each.at(OURS, DELAY_MS).mean, each.at("hold", DELAY_MS).mean
        best = min((kind for kind in PREDICTORS if kind != OURS), key=lambda kind: each.at(kind, DELAY_MS).mean)
        apart = interval((each.errors[OURS] - each.errors[best])[:, HORIZONS.index(DELAY_MS)])
        verdict = "better than" if apart.high < 0.0 else "worse than" if apart.low > 0.0 else "not distinct from"
        lines.append(
            f"{each.scene:>12}  {OURS} {ours / held:.2f} of hold, {verdict} the best other, {best}: "
            f"{100 * apart.mean:+.2f} in pairs ({100 * apart.low:+.2f} to {100 * apart.high:+.2f})"
        )
    return lines


def _write_comparisons(found: Sequence[PredictorComparison], folder: Path) -> None:
    """Write all tables; errors are shares of the force, low and high their 95 % interval."""
    rows: dict[str, list[str]] = {name: [head] for name, head in HEADS.items()}
    for each in found:
        for kind, errors in each.errors.items():
            for horizon in HORIZONS:
                at = each.at(kind, horizon)
                rows["errors.csv"].append(_line(each.scene, kind, horizon, len(errors), at.mean, at.low, at.high))
        for kind, (median, p99) in each.cost_us.items():
            rows["cost.csv"].append(_line(each.scene, kind, median, p99))
        for value in each.eigenvalues.tolist():
            rows["spectrum.csv"].append(_line(each.scene, value.real, value.imag, abs(value)))
        for size, at in each.sizes.items():
            rows["training.csv"].append(_line(each.scene, size, at.mean, at.low, at.high))
        for kind, (at, cost_us) in each.slow.items():
            rows["slow_model.csv"].append(_line(each.scene, kind, at.mean, at.low, at.high, cost_us))
    for name, lines in rows.items():
        with whole_file(folder / name) as temporary:
            temporary.write_text("\n".join(lines) + "\n", "utf-8")


def _line(*cells: object) -> str:
    return ",".join(cell if isinstance(cell, str) else repr(cell) for cell in cells)
