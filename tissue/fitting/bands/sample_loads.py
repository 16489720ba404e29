"""Loads and summary values of samples, computed from one run or from a run of each sample."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.fitting.bands.sample import Ranges, ranges_of, sampled
from tissue.materials.constants import CuttingCoefficients, Prior
from tissue.models.tissue_model import SLOW
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.load_record import LoadRecord
from tissue.simulation.run import Run
from tissue.simulation.run_folder import Summary
from tissue.simulation.simulate import simulate
from tissue.system.workers import finished

CHANNELS = (
    "force_x_N",
    "force_y_N",
    "force_z_N",
    "force_N",
    "torque_x_Nm",
    "torque_y_Nm",
    "torque_z_Nm",
    "torque_Nm",
)
"""Components and magnitudes of the model's loads on the tool, in the world frame."""
DENSITY = "density.bone"
BLOCK = 500_000
"""Number of loads that are in memory at once: 4 MB, about the size of a processor cache."""
LAW = re.compile(r"median ([\d.]+) kg/m3, 90 % between ([\d.]+) and ([\d.]+)")


class Reweighed:
    """A run's loads as a function of the constants that vary.

    Parameters
    ----------
    record
        Recorded geometry of every tick of the run.
    """

    def __init__(self, record: LoadRecord) -> None:
        self.record = record
        self._contact = record.trace["contact_mm2"] > 0.0
        units = [layer.unit.any(axis=(0, 1, 3)) for layer in record.layers.values()]
        # ticks without a load stay zero in every sample and are not computed
        self._loaded = (
            np.flatnonzero(np.logical_or.reduce(units, axis=0))
            if units
            else np.zeros(0, dtype=np.int64)
        )

    @cached_property
    def ranges(self) -> Ranges:
        """Constants that belong to touched layers and have a range.

        Constants that the scene sets itself are left out.
        """
        met = [self.record.layer_names[at] for at in sorted(self.record.layers)]
        density = density_prior(self.record.notes.get("density law", ""))
        further = {} if density is None else {DENSITY: density}
        return ranges_of(self.record.scene, met, table="cutting.", further=further)

    def coefficients(self, x: Array) -> tuple[CuttingCoefficients, ...]:
        """Return the cutting coefficients of each layer for constants `x` of shape (p,)."""
        cutting = self.record.scene.cutting
        changes = cutting.model_dump(exclude={"material"})
        held = sampled(self.record.scene.constants, self.ranges.names, x)
        return held.coefficients(self.record.layer_names, changes, bone=cutting.material)

    def nominal(self) -> Array:
        """Return the values of the constants at which the run was simulated, shape (p,)."""
        return np.array([prior.value for prior in self.ranges.priors])

    def weights(self, x: Array) -> Array:
        """Return the factors, shape (samples, unit loads), by which the unit loads are multiplied.

        The constants `x` of the samples have shape (samples, p). Unit loads are described in
        `tissue.simulation.load_record.LayerLoads`.
        """
        layers = len(self.record.layer_names)
        # without an image of densities, no sample changes them
        place = self.ranges.names.index(DENSITY) if DENSITY in self.ranges.names else None
        rows = []
        for each in x:
            factors = None if place is None else np.full(layers, each[place])
            rows.append(
                np.concatenate(list(self.record.weights(self.coefficients(each), factors).values()))
            )
        return np.array(rows)

    def figures(self, x: Array) -> Array:
        """Return the summary values `LOADS` for constants `x`, shape (samples, 4)."""
        weights = self.weights(x)
        peak = np.zeros((len(x), 2))
        sums = np.zeros((len(x), 2))
        for ticks, loads in self._blocks(weights):
            # force and torque, three components each
            parts = loads.reshape(*loads.shape[:2], 2, 3)
            sizes = np.sqrt(np.einsum("sncd,sncd->snc", parts, parts))
            peak = np.maximum(peak, sizes.max(axis=1))
            sums += sizes[:, self._contact[ticks]].sum(axis=1)
        # without contact, the means are 0
        means = sums / max(int(self._contact.sum()), 1)
        return np.stack([peak[:, 0], means[:, 0], peak[:, 1], means[:, 1]], axis=1)

    def quantiles(self, x: Array, levels: tuple[float, ...]) -> Array:
        """Return quantiles of the loads over all samples at each tick, shape (levels, n, 8)."""
        found = np.zeros((len(levels), len(self.record.times_s), len(CHANNELS)))
        for ticks, loads in self._blocks(self.weights(x)):
            found[:, ticks] = np.quantile(with_sizes(loads), levels, axis=0)
        return found

    def _blocks(self, weights: Array) -> Iterator[tuple[Ints, Array]]:
        """Yield blocks of loads, shape (samples, ticks, 6), and the indices of their ticks.

        A block contains consecutive ticks with a load. Ticks without a load are left out.
        """
        # six loads of each sample and tick
        step = max(BLOCK // (6 * len(weights)), 1)
        for first in range(0, len(self._loaded), step):
            ticks = self._loaded[first : first + step]
            unit = [layer.unit[:, :, ticks] for layer in self.record.layers.values()]
            rows = np.concatenate(
                [each.reshape(each.shape[0] * each.shape[1], -1) for each in unit]
            )
            yield ticks, (weights @ rows).reshape(len(weights), -1, 6)


def with_sizes(loads: Array) -> Array:
    """Append the magnitudes of force and torque to the components.

    The shape changes from (..., 6) to (..., 8).

    The components have the order of `CHANNELS`.
    """
    force = loads[..., :3]
    torque = loads[..., 3:]
    sizes = [np.linalg.norm(each, axis=-1, keepdims=True) for each in (force, torque)]
    return np.concatenate([force, sizes[0], torque, sizes[1]], axis=-1)


def density_prior(law: str) -> Prior | None:
    """Return the prior of a layer's density factor from the note `law` on the CT-to-density law.

    The result is None if the note describes no law. The note gives the median density and its 90 %
    range. The range relative to the median is applied to every voxel.
    """
    found = LAW.search(law)
    # a density that the scene states has no law and no band
    if found is None:
        return None
    median, low, high = map(float, found.groups())
    return Prior(1.0, low / median, high / median)


Figure = tuple[str, ...]
"""Name of a summary value: the keys that lead to the value in ``summary.json``.

For the time of an event, the keys are ``events``, the sentence of the event and ``time_s``.
"""
LEVELS = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
"""Quantiles by their names in files: the ends of the 90 and 50 % bands, and the median."""
LOADS: tuple[Figure, ...] = tuple(
    (name, figure) for name in ("force_N", "torque_Nm") for figure in ("peak", "mean_in_contact")
)
"""Summary values that every run has. Sobol indices are computed for these values."""
NUMBER = re.compile(r"-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\d.]*%)")
"""Pattern of a measured number in the sentence of an event.

A percentage is not matched, because it is a threshold that distinguishes two events.
"""
PEAKS = "_K"
STRESS = "von_mises_"
LARGEST_PREFIX = "greatest_"
"""Prefix in the name of a summary value that is the largest value of a field.

`PEAKS` is the suffix of trace columns (temperatures) whose largest value is a summary value.
"""


def figures_of(run: Run) -> dict[Figure, float]:
    """Return the numbers that summarise a run.

    The numbers are loads, volumes, the contact share, clearances, the largest temperature and
    stress, and times of events. An event is named by its message with the numbers removed, and only
    its first occurrence counts. Events that report that the computer was too slow are left out.
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
            # a position, such as that of the smallest distance, is a list
            if isinstance(value, float)
        }
    found |= {("bone_heat", name): value for name, value in summary.get("bone_heat", {}).items()}
    for name in run.parts.tissue.measure_names:
        if name.endswith(PEAKS):
            found[f"{LARGEST_PREFIX}{name}",] = float(trace[name].max())
    if (fields := run.parts.fields) is not None:
        for frame in fields.frames:
            for name, values in frame.cells.items():
                if name.startswith(STRESS) and np.isfinite(values).any():
                    largest = f"{LARGEST_PREFIX}{name}"
                    found[largest,] = max(found.get((largest,), 0.0), float(np.nanmax(values)))
    # the first hole only: samples may have different numbers of holes
    for first in summary.get("break_through", ())[:1]:
        found |= {("break_through", name): value for name, value in first.items()}
    for event in summary["events"]:
        if SLOW in event["what"]:
            continue
        found.setdefault(("events", NUMBER.sub("…", event["what"]), "time_s"), event["time_s"])
    return found


def table_of(runs: list[dict[Figure, float]]) -> tuple[tuple[Figure, ...], Array]:
    """Return the names of all summary values, and the values in each run, shape (runs, figures).

    If a run does not have a summary value, the entry is NaN.
    """
    names = tuple(dict.fromkeys(name for run in runs for name in run))
    return names, np.array([[run.get(name, np.nan) for name in names] for run in runs])


def intervals(names: tuple[Figure, ...], values: Array) -> Summary:
    """Return quantiles of summary values as nested dictionaries, like a run's summary.

    For a summary value that only some runs have, the share of these runs is added.

    Parameters
    ----------
    values
        Summary values, shape (runs, figures), NaN where a run does not have the value.
    """
    found: Summary = {}
    for name, column in zip(names, values.T, strict=True):
        inside = found
        for part in name[:-1]:
            inside = inside.setdefault(part, {})
        there = column[np.isfinite(column)]
        inside[name[-1]] = _by_level(there)
        # the share of an event is given even if it is 1, next to its time
        if name[0] == "events":
            inside["share"] = len(there) / len(column)
        elif len(there) < len(column):
            inside[name[-1]]["share"] = len(there) / len(column)
    return found


def _by_level(values: Array) -> dict[str, float]:
    """Return quantiles of numbers, keyed by the names in `LEVELS`."""
    return dict(zip(LEVELS, np.quantile(values, tuple(LEVELS.values())).tolist(), strict=True))


REACH = 0.9
"""Smallest share of runs that must last until a tick for which quantiles are computed.

With a smaller share, the 5 and 95 % quantiles would describe only a part of the runs.
"""


def over_time(loads: list[Array], times_s: Array) -> tuple[Array, Summary]:
    """Compute the quantiles `LEVELS` of the loads at each tick.

    Runs may end at different ticks. A tick has quantiles if at least nine in ten runs last until
    this tick. The quantiles are computed from the runs that last until this tick.

    Parameters
    ----------
    loads
        Loads of each run, shape (ticks of the run, channels).
    times_s
        Times of the run at nominal constants [s], shape (n,). There are no quantiles beyond the end
        of this run.

    Returns
    -------
    Quantiles, shape (5, ticks, channels), and a summary of the time span that the quantiles cover.
    """
    lengths = np.sort([len(each) for each in loads])
    reached = len(lengths) - np.searchsorted(lengths, np.arange(len(times_s)), side="right")
    last = int((reached >= REACH * len(lengths)).sum())
    padded = np.full((len(loads), last, loads[0].shape[1]), np.nan)
    for row, each in zip(padded, loads, strict=True):
        row[: len(each)] = each[:last]
    # np.quantile takes less time, but knows no missing ticks
    compute = np.quantile if lengths[0] >= last else np.nanquantile
    quantiles = compute(padded, tuple(LEVELS.values()), axis=0)
    # the first time of a trace is one step after the start
    step_s = times_s[0] if len(times_s) == 1 else times_s[1] - times_s[0]
    return quantiles, {
        "ticks": last,
        "ends_s": float(times_s[last - 1]) if last else 0.0,
        "run_ends_s": float(times_s[-1]),
        "shortest_sample_s": float(step_s * lengths[0]),
        "samples_at_end": int(reached[last - 1]) if last else 0,
    }


Outcome = tuple[Array, dict[Figure, float]] | str
"""Loads, shape (n, 8), and summary values of a run; or the reason why the run failed."""


@dataclass(frozen=True)
class Workers:
    """Place where samples run: this process, several local processes or a Dask scheduler."""

    count: int = 1
    scheduler: str | None = None
    compute: str = "cpu"


def reruns(
    scene: Scene, files: tuple[str, ...], *, workers: Workers, report: Progress
) -> Iterator[tuple[int, Outcome]]:
    """Run a scene with each materials file, and yield each run's number and outcome when it ends.

    Raises
    ------
    InputError
        If no scheduler answers, or workers are lost repeatedly.
    """
    samples = tuple(enumerate(files))
    work = partial(_outcome, scene, workers.compute)
    # one process needs no pool
    if workers.count <= 1 and workers.scheduler is None:
        for number, text in samples:
            report(f"sample {number + 1} of {len(files)}", number / len(files))
            yield number, work((number, text))
        return
    ended = list[int]()

    def report_share(doing: str) -> None:
        report(doing, len(ended) / len(files))

    for done in finished(
        work,
        samples,
        # a scheduler gets all samples at once, because the number of its workers is not known
        workers=min(workers.count, len(files)) if workers.scheduler is None else len(files),
        scheduler=workers.scheduler,
        report=report_share,
    ):
        for (number, _), outcome in done:
            ended.append(number)
            yield number, _sentence(outcome) if isinstance(outcome, Exception) else outcome
        report_share(f"sample {len(ended)} of {len(files)}")


def _outcome(scene: Scene, compute: str, sample: tuple[int, str]) -> Outcome:
    """Run the scene with the constants of a sample, and return the outcome.

    `sample` contains the number of the sample and the text of its materials file.
    """
    with TemporaryDirectory(prefix="tissue-band-") as name:
        path = Path(name, "sample.toml")
        path.write_text(sample[1], "utf-8")
        try:
            run = simulate(changed(scene, {"materials": str(path)}), compute=compute, cores=1)
        except InputError as refused:
            return str(refused)
        except Exception as error:
            # if a solver fails for one sample, the other samples must not be lost
            return _sentence(error)
    loads = loads_of(run)
    if not np.isfinite(loads).all():
        return "its force is not finite"
    return loads, figures_of(run)


def loads_of(run: Run) -> Array:
    """Return the model's force and torque on the tool, and their magnitudes, shape (n, 8)."""
    trace = run.trace
    loads = [trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")]
    return with_sizes(np.hstack(loads))


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
