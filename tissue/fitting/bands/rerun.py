"""Loads and figures of a scene for samples of its constants, one run per sample."""

import re
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.fitting.bands.reweighed import with_sizes
from tissue.models.tissue_model import SLOW
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.run import Run
from tissue.simulation.run_summary import Summary
from tissue.simulation.simulate import simulate
from tissue.system.pools import LOST, executor
from tissue.system.workers import first_done

__all__ = [
    "GREATEST",
    "LEVELS",
    "LOADS",
    "Figure",
    "Outcome",
    "Workers",
    "figures_of",
    "intervals",
    "loads_of",
    "over_time",
    "reruns",
    "table_of",
]

Figure = tuple[str, ...]
"""Name of a figure: its position in ``summary.json``, entry by entry.

For an event it is ``events``, a sentence, ``time_s``.
"""
LEVELS = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
"""Quantiles by their names in files: the ends of the 90 and 50 % bands, and the median."""
LOADS: tuple[Figure, ...] = tuple(
    (name, figure) for name in ("force_N", "torque_Nm") for figure in ("peak", "mean_in_contact")
)
"""Figures that every run has, the first columns of a table. Sobol indices refer to them."""
NUMBER = re.compile(r"-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\d.]*%)")
"""Pattern of a measured number in the sentence of an event.

A percentage is not matched: it is a threshold, which distinguishes two events.
"""
PEAKS = "_K"
STRESS = "von_mises_"
GREATEST = "greatest_"
"""Prefix of fields, and of the figure's name, whose largest value is a figure.

`PEAKS` is the suffix of trace columns (temperatures) whose largest value is a figure.
"""


def figures_of(run: Run) -> dict[Figure, float]:
    """Return the figures of a run.

    The figures are loads, volumes, contact, clearances, largest temperature and stress, and events.
    An event is named by its sentence without numbers, and only its first occurrence counts. Events
    about a machine that was too slow are left out.
    """
    summary = run.summary
    trace = run.trace
    found: dict[Figure, float] = {name: summary[name[0]][name[1]] for name in LOADS}
    found |= {
        ("removed_mm3", layer): volume
        for layer, volume in summary["removed_mm3"].items()
        if summary["cuts"]
    }
    found["contact_share",] = float((trace["contact_mm2"] > 0.0).mean())
    for structure, figures in summary.get("keep_clear", {}).items():
        found |= {
            ("keep_clear", structure, name): value
            for name, value in figures.items()
            if value is not None
        }
    for name in run.parts.tissue.measure_names:
        if name.endswith(PEAKS):
            found[f"{GREATEST}{name}",] = float(trace[name].max())
    if (fields := run.parts.fields) is not None:
        for frame in fields.frames:
            for name, values in frame.cells.items():
                if name.startswith(STRESS) and np.isfinite(values).any():
                    greatest = f"{GREATEST}{name}"
                    found[greatest,] = max(found.get((greatest,), 0.0), float(np.nanmax(values)))
    for first in summary.get("break_through", ())[:1]:
        found |= {("break_through", name): value for name, value in first.items()}
    for event in summary["events"]:
        if SLOW in event["what"]:
            continue
        found.setdefault(("events", NUMBER.sub("…", event["what"]), "time_s"), event["time_s"])
    return found


def table_of(runs: list[dict[Figure, float]]) -> tuple[tuple[Figure, ...], Array]:
    """Return the names of all figures and their values in each run, shape (runs, figures).

    A value is NaN where a run does not have the figure.
    """
    names = tuple(dict.fromkeys(name for run in runs for name in run))
    return names, np.array([[run.get(name, np.nan) for name in names] for run in runs])


def intervals(names: tuple[Figure, ...], values: Array) -> Summary:
    """Return quantiles of figures, nested as in a run's summary.

    A figure that only some runs have comes with the share of these runs.

    Parameters
    ----------
    values
        Shape (runs, figures), NaN where a run has no such figure.
    """
    found: Summary = {}
    for name, column in zip(names, values.T, strict=True):
        inside = found
        for part in name[:-1]:
            inside = inside.setdefault(part, {})
        there = column[np.isfinite(column)]
        inside[name[-1]] = _by_level(there)
        if name[0] == "events":
            inside["share"] = len(there) / len(column)
        elif len(there) < len(column):
            inside[name[-1]]["share"] = len(there) / len(column)
    return found


def _by_level(values: Array) -> dict[str, float]:
    """Return quantiles of numbers by their names."""
    return dict(zip(LEVELS, np.quantile(values, tuple(LEVELS.values())).tolist(), strict=True))


REACH = 0.9
"""Smallest share of the runs that a quantile over time may be computed from.

The 5 and 95 % quantiles of fewer runs would describe only a part of them.
"""


def over_time(loads: list[Array], times_s: Array) -> tuple[Array, Summary]:
    """Compute the quantiles `LEVELS` of the loads at each tick.

    A tick counts as long as nine in ten runs reach it. The quantiles are computed from these runs.

    Parameters
    ----------
    loads
        Loads of each run, shape (ticks of the run, channels).
    times_s
        Times of the run at nominal constants, shape (n,). There are no quantiles beyond its end.

    Returns
    -------
    Quantiles, shape (5, ticks, channels), and the span over which they are valid.
    """
    lengths = np.sort([len(each) for each in loads])
    reached = len(lengths) - np.searchsorted(lengths, np.arange(len(times_s)), side="right")
    last = int((reached >= REACH * len(lengths)).sum())
    shortest = min(int(lengths[0]), last)
    levels = tuple(LEVELS.values())
    quantiles = np.empty((len(levels), last, loads[0].shape[1]))
    quantiles[:, :shortest] = np.quantile(
        np.stack([each[:shortest] for each in loads]), levels, axis=0
    )
    for tick in range(shortest, last):
        quantiles[:, tick] = np.quantile(
            [each[tick] for each in loads if len(each) > tick], levels, axis=0
        )
    step_s = times_s[0] if len(times_s) == 1 else times_s[1] - times_s[0]
    return quantiles, {
        "ticks": last,
        "ends_s": float(times_s[last - 1]) if last else 0.0,
        "run_ends_s": float(times_s[-1]),
        "shortest_sample_s": float(step_s * lengths[0]),
        "samples_at_end": int(reached[last - 1]) if last else 0,
    }


Outcome = tuple[Array, dict[Figure, float]] | str
"""Loads, shape (n, 8), and figures of a run; or the reason of its failure."""
PATIENCE_S = 30.0
"""Time that a scheduler may take to answer [s], equal to the value of a study."""
LOST_WORKER = "the process that ran it was lost"
BARREN = 5
"""Consecutive losses without a finished sample after which the workers are abandoned.

The value is equal to the value of a study.
"""


@dataclass(frozen=True)
class Workers:
    """Place where samples run: this process, several local processes or a Dask scheduler."""

    count: int = 1
    scheduler: str | None = None
    compute: str = "cpu"


def reruns(
    scene: Scene, files: tuple[str, ...], *, workers: Workers, report: Progress
) -> Iterator[tuple[int, Outcome]]:
    """Yield the number and the outcome of the run of each file of materials, as each run ends.

    If a worker is lost, its samples are run again, one at a time. A sample that is lost again is
    counted as the cause of the loss.

    Raises
    ------
    InputError
        If no scheduler answers, or workers are lost again and again.
    """
    if workers.count <= 1 and workers.scheduler is None:
        for number, text in enumerate(files):
            report(f"sample {number + 1} of {len(files)}", number / len(files))
            yield number, _outcome(scene, text, workers.compute)
        return
    waiting = list(range(len(files)))
    suspects = list[int]()
    barren = 0
    while waiting or suspects:
        alone = not waiting
        numbers = [suspects.pop(0)] if alone else waiting
        returned = set[int]()
        given = set[int]()
        for number, outcome in _in_pool(scene, files, numbers, workers, report):
            if outcome is None:
                given.add(number)
            else:
                given.remove(number)
                returned.add(number)
                yield number, outcome
        barren = 0 if returned else barren + 1
        if barren > BARREN:
            raise InputError(
                "workers", "stay alive", f"{barren} losses without a sample", "leave workers out"
            )
        if alone:
            yield from ((number, LOST_WORKER) for number in given)
        else:
            suspects += sorted(given)
            waiting = [number for number in waiting if number not in returned | given]


def _in_pool(
    scene: Scene, files: tuple[str, ...], numbers: list[int], workers: Workers, report: Progress
) -> Iterator[tuple[int, Outcome | None]]:
    """Yield outcomes of samples on one pool until it is lost.

    The outcome of a sample is None when it is submitted.
    """
    most = 2 * min(workers.count, len(numbers)) if workers.scheduler is None else len(numbers)
    connected = False
    fresh = iter(numbers)
    running = dict[Future[Outcome], int]()
    try:
        with executor(
            min(workers.count, len(numbers)), workers.scheduler, patience_s=PATIENCE_S
        ) as pool:
            connected = True
            while True:
                while len(running) < most and (number := next(fresh, None)) is not None:
                    running[pool.submit(_outcome, scene, files[number], workers.compute)] = number
                    yield number, None
                if not running:
                    return
                report(f"{len(running)} samples are running", min(running.values()) / len(files))
                for future in first_done(pool, running, report):
                    error = future.exception()
                    number = running[future]
                    if isinstance(error, LOST):
                        raise error
                    del running[future]
                    yield number, future.result() if error is None else _sentence(error)
    except LOST as error:
        if not connected:
            raise InputError(
                "scheduler",
                "answer",
                f"{workers.scheduler} ({error})",
                "start it with `dask scheduler`",
            ) from error
        report("workers were lost, the other samples go on", 0.0)


def _outcome(scene: Scene, file: str, compute: str) -> Outcome:
    """Run one file of materials and return the outcome, including any failure."""
    with TemporaryDirectory(prefix="tissue-band-") as name:
        path = Path(name, "sample.toml")
        path.write_text(file, "utf-8")
        try:
            run = simulate(changed(scene, {"materials": str(path)}), compute=compute, cores=1)
        except InputError as refused:
            return str(refused)
        except Exception as error:
            # a solver that breaks down at one sample is no reason to lose the others
            return _sentence(error)
    loads = loads_of(run)
    if not np.isfinite(loads).all():
        return "its force is not finite"
    return loads, figures_of(run)


def loads_of(run: Run) -> Array:
    """Return forces and torques of the model on the tool with their sizes, shape (n, 8)."""
    trace = run.trace
    loads = [trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")]
    return with_sizes(np.hstack(loads))


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
