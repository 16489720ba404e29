"""The band of a run: its loads and figures over the ranges of its constants, and which constant matters."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from meshes.base.progress import Progress, silent
from tissue.scene.scene import Scene
from tissue.simulation.load_record import record_loads, why_not_linear
from tissue.simulation.run_summary import Summary
from tissue.simulation.simulate import simulate
from tissue.uncertainty.rerun import ranges_of, reruns
from tissue.uncertainty.reweighed import FIGURES, Reweighed, with_sizes
from tissue.uncertainty.sample import LEAST, Ranges, normals, rounded
from tissue.uncertainty.sample_files import sample_text
from tissue.uncertainty.sobol import SobolIndices, sobol_indices
from tissue.uncertainty.surrogate import surrogate_indices

__all__ = ["HOW", "LEVELS", "Band", "band_of", "require_band", "require_same"]

LEVELS = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
"""Quantiles by their names in files: the ends of the 90 and 50 % bands, and the median."""
HOW = "the geometry was recorded once and reweighed, for the force is linear in the coefficients and the path is given"
HOW_RERUN = "every sample was run, for the force is not linear in the constants or moves the tool"
SAME = 1e-5
"""Of the greatest load: single precision of the kernels, and six digits of a trace in a file."""
SOBOL_ROWS = 512
"""Rows of each of the two samples behind the indices."""


@dataclass(frozen=True, eq=False)
class Band:
    """The band of a run.

    Attributes
    ----------
    times_s
        Shape (n,).
    nominal, quantiles
        Loads on the tool at the constants' nominal values and their quantiles `LEVELS`, columns
        `tissue.uncertainty.reweighed.CHANNELS`, shapes (n, 8) and (5, n, 8).
    constants, values
        Names of the constants that vary, and their values in each sample, shape (samples, p).
    figures
        `tissue.uncertainty.reweighed.FIGURES` of each sample, shape (samples, 4).
    files
        The file of materials of each sample; none of a band that was read.
    summary
        What ``summary.json`` holds of it under ``band``.
    """

    times_s: Array
    nominal: Array
    quantiles: Array
    constants: tuple[str, ...]
    values: Array
    figures: Array
    files: tuple[str, ...]
    summary: Summary

    def __repr__(self) -> str:
        peak = self.summary["force_N"]["peak"]
        return f"<tissue Band of {len(self.values)} samples, peak force {peak['p05']:.3g} to {peak['p95']:.3g} N>"


def require_band(scene: Scene, asked: int, workers: int | None) -> None:
    """Refuse options of a band that cannot be met, before the scene is run.

    Raises
    ------
    InputError
        If the number of samples is none of 16 to 65536, or processes are asked for where nothing is run again.
    """
    rounded(asked)
    if workers is not None:
        require_range("workers", workers, 1, 4096, "use one a core")
        if not why_not_linear(scene):
            raise InputError(
                f"workers must be left out where the geometry is recorded once and reweighed, got {workers}: remove it"
            )


def band_of(
    scene: Scene,
    asked: int,
    *,
    seed: int | None = None,
    workers: int | None = None,
    compute: str = "cpu",
    cores: int | None = None,
    progress: Progress | None = None,
) -> Band:
    """The band of a scene's loads.

    Parameters
    ----------
    scene
        What was simulated.
    asked
        Samples, rounded up to a power of two.
    seed
        Seed of the samples; that of the scene without it.
    workers
        Processes that run samples beside each other, where each is a run of its own.
    compute, cores, progress
        As for `tissue.simulate`.

    Raises
    ------
    InputError
        As `require_band`, or if no constant has a range.
    """
    report = progress or silent
    require_band(scene, asked, workers)
    seed = scene.seed if seed is None else seed
    if why_not_linear(scene):
        return _rerun(scene, asked, seed, workers=workers or 1, compute=compute, cores=cores, report=report)
    reweighed = Reweighed(record_loads(scene, compute=compute, cores=cores, progress=progress))
    ranges, record = reweighed.ranges, reweighed.record
    _require_ranges(ranges)
    report("reweighing the loads", 0.0)
    values = ranges.x(normals(rounded(asked), len(ranges.names), seed=seed))
    figures = reweighed.figures(values)
    quantiles = reweighed.quantiles(values, tuple(LEVELS.values()))
    nominal = with_sizes(record.loads(reweighed.coefficients(reweighed.nominal())))
    report("computing Sobol indices", 0.5)
    indices = sobol_indices(lambda free: reweighed.figures(ranges.x(free)), ranges.groups, count=SOBOL_ROWS, seed=seed)
    files = tuple(sample_text(record.scene.constants, ranges.names, each) for each in values)
    summary = _summary(asked, seed, HOW, [], figures, ranges, indices)
    return Band(record.times_s, nominal, quantiles, ranges.names, values, figures, files, summary)


def _rerun(
    scene: Scene, asked: int, seed: int, *, workers: int, compute: str, cores: int | None, report: Progress
) -> Band:
    """A band each of whose samples is a run of its own."""
    trace = simulate(scene, compute=compute, cores=cores, progress=report).trace
    nominal = with_sizes(np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")]))
    ranges = ranges_of(scene, trace.layer_names)
    _require_ranges(ranges)
    free = normals(rounded(asked), len(ranges.names), seed=seed)
    values = ranges.x(free)
    files = tuple(sample_text(scene.constants, ranges.names, each) for each in values)
    outcomes = dict(reruns(scene, files, workers=workers, compute=compute, report=report))
    problems = sorted({each for each in outcomes.values() if isinstance(each, str)})
    loads, rows, kept = [], [], []
    for number, outcome in sorted(outcomes.items()):
        if not isinstance(outcome, str):
            loads.append(outcome[0])
            rows.append(outcome[1])
            kept.append(number)
    if len(kept) < LEAST:
        raise InputError(
            f"band must have {LEAST} samples that can be run, got {len(kept)} of {len(files)} ({'; '.join(problems)}): "
            "narrow the ranges, or use more"
        )
    shortest = min(len(nominal), *map(len, loads))
    quantiles = np.quantile(np.stack([each[:shortest] for each in loads]), tuple(LEVELS.values()), axis=0)
    figures = np.array(rows)
    indices, explained = surrogate_indices(free[kept], figures, ranges.groups, seed=seed)
    summary = _summary(asked, seed, HOW_RERUN, problems, figures, ranges, indices)
    summary |= {"refused": len(files) - len(kept), "ticks": shortest}
    summary["surrogate_explains"] = {
        name: float(share) for name, share in zip(FIGURES, explained, strict=True) if np.isfinite(share)
    }
    times = trace["time_s"][:shortest]
    return Band(
        times,
        nominal[:shortest],
        quantiles,
        ranges.names,
        values[kept],
        figures,
        tuple(files[at] for at in kept),
        summary,
    )


def _require_ranges(ranges: Ranges) -> None:
    if not ranges.names:
        raise InputError("band must be of a scene that rests on constants with a range, got none: leave it out")


def _summary(
    asked: int, seed: int, how: str, problems: list[str], figures: Array, ranges: Ranges, indices: SobolIndices
) -> Summary:
    return {
        "samples": len(figures),
        "asked": asked,
        "seed": seed,
        "refused": 0,
        "problems": problems,
        "how": how,
        **_quantiles(figures),
        "constants": _constants(ranges),
        "sobol": _indices(indices, ranges),
    }


def require_same(band: Band, loads: Array) -> None:
    """Refuse a run whose loads are not those that the band has at the run's nominal constants.

    Parameters
    ----------
    loads
        The run's force [N] and torque [N m] as the model gives them, shape (n, 6).

    Raises
    ------
    InputError
        If there are fewer ticks, or loads differ by more than 1e-5 of the greatest.
    """
    if len(loads) < len(band.times_s):
        raise InputError(
            f"band must be of a whole run, got one that was stopped after {len(loads)} of {len(band.times_s)} ticks: "
            "run the scene again"
        )
    for first, columns in ((0, slice(0, 3)), (4, slice(3, 6))):
        nominal, run = band.nominal[:, first : first + 3], loads[: len(band.times_s), columns]
        if np.abs(nominal - run).max(initial=0.0) > SAME * np.abs(run).max(initial=0.0):
            raise InputError(
                "band must be of a run whose scene is as it was, got other loads from the same scene: run it again"
            )


def _quantiles(figures: Array) -> dict[str, dict[str, dict[str, float]]]:
    """Quantiles of the figures, nested as a run's summary has them."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, column in zip(FIGURES, figures.T, strict=True):
        outer, inner = name.split(".")
        levels = zip(LEVELS, np.quantile(column, tuple(LEVELS.values())).tolist(), strict=True)
        found.setdefault(outer, {})[inner] = dict(levels)
    return found


def _constants(ranges: Ranges) -> dict[str, dict[str, float]]:
    return {
        name: {"value": prior.value, "low": prior.low, "high": prior.high}
        for name, prior in zip(ranges.names, ranges.priors, strict=True)
    }


def _indices(found: SobolIndices, ranges: Ranges) -> dict[str, dict[str, dict[str, object]]]:
    """Indices by figure and group; none of a figure that does not vary."""
    return {
        figure: {
            group: {
                "first": float(found.first[row, column]),
                "first_90": found.first_ends[:, row, column].tolist(),
                "total": float(found.total[row, column]),
                "total_90": found.total_ends[:, row, column].tolist(),
            }
            for row, group in enumerate(ranges.group_names)
        }
        for column, figure in enumerate(FIGURES)
        if np.isfinite(found.total[:, column]).all()
    }
