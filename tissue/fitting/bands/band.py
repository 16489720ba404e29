"""The band of a run: its loads and figures over the ranges of its constants, and which constant
matters.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from meshes.base.progress import Progress, silent
from tissue.fitting.bands.figures import (
    GREATEST,
    LEVELS,
    LOADS,
    Figure,
    intervals,
    over_time,
    table_of,
)
from tissue.fitting.bands.rerun import Workers, reruns
from tissue.fitting.bands.reweighed import Reweighed, density_prior, with_sizes
from tissue.fitting.bands.sample import (
    Ranges,
    normals,
    ranges_of,
    rounded,
    sample_name,
    sample_text,
)
from tissue.fitting.bands.sobol import SobolIndices, sobol_indices, surrogate_indices
from tissue.scene.scene import Scene
from tissue.simulation.load_record import record_loads, why_not_linear
from tissue.simulation.run_folder import Summary
from tissue.simulation.simulate import simulate

__all__ = ["Band", "band_of", "require_band", "require_same"]

SAME_EVERYWHERE = (
    "does not vary with the constants: the path is given, so that the run's own figure holds in "
    "every sample"
)
NEEDS_RUNS = (
    "depends on constants, and the loads alone were reweighed: it needs a run of each sample, "
    "--each-run"
)


def _about(
    asked: int,
    seed: int,
    how: str,
    ranges: Ranges,
    indices: SobolIndices,
    figures: tuple[Figure, ...] = LOADS,
) -> Summary:
    """Return the entries of ``summary.json`` on the method, the constants and their indices."""
    return {
        "asked": asked,
        "seed": seed,
        "how": how,
        "constants": _constants(ranges),
        "sobol": _indices(indices, ranges, figures),
    }


def _without(scene: Scene) -> dict[str, str]:
    """Return the figures without an interval for reweighed loads, and the reason."""
    names = ["removed_mm3", "contact_share"] + ["keep_clear"] * (scene.keep_clear is not None)
    found = dict.fromkeys([*names, "break_through", "events"], SAME_EVERYWHERE)
    if scene.heat:
        found |= dict.fromkeys(("greatest_pulp_rise_K", "events"), NEEDS_RUNS)
    if scene.stress is not None:
        found["stress"] = NEEDS_RUNS
    return found


def _constants(ranges: Ranges) -> dict[str, dict[str, float]]:
    return {
        name: {"value": prior.value, "low": prior.low, "high": prior.high}
        for name, prior in zip(ranges.names, ranges.priors, strict=True)
    }


def _indices(
    found: SobolIndices, ranges: Ranges, figures: tuple[Figure, ...]
) -> dict[str, dict[str, dict[str, object]]]:
    """Return Sobol indices by figure and group, without figures that do not vary."""
    return {
        ".".join(figure): {
            group: {
                "first": float(found.first[row, column]),
                "first_90": found.first_ends[:, row, column].tolist(),
                "total": float(found.total[row, column]),
                "total_90": found.total_ends[:, row, column].tolist(),
            }
            for row, group in enumerate(ranges.group_names)
        }
        for column, figure in enumerate(figures)
        if np.isfinite(found.total[:, column]).all()
    }


HOW = (
    "the geometry was recorded once and reweighed, for the force is linear in the coefficients "
    "and the path is given"
)
HOW_RERUN = "every sample was run, for the force is not linear in the constants or moves the tool"
HOW_ASKED = "every sample was run, as was asked for"
MOST_FAILED = 0.1
"""Largest share of samples that may fail.

With more failed samples, the ends of a 90 % band would describe only the remaining samples.
"""
SAME = 1e-5
"""Tolerance of loads as a share of the largest load.

It covers the single precision of the kernels and the six digits of a trace in a file.
"""
SOBOL_ROWS = 512
"""Rows of each of the two samples behind the indices."""


@dataclass(frozen=True, eq=False)
class Band:
    """Band of a run.

    Attributes
    ----------
    times_s
        Times of the ticks [s], shape (n,).
    nominal, quantiles
        Loads on the tool at the constants' nominal values and their quantiles `LEVELS`, columns
        `tissue.fitting.bands.reweighed.CHANNELS`, shapes (n, 8) and (5, n, 8).
    constants, values
        Names of the constants that vary, and their values in each sample, shape (samples, p).
    figure_names, figures
        Names as in `tissue.fitting.bands.figures`, and the figures of each sample, shape (samples,
        figures). NaN where a sample does not have the figure, such as an event that does not
        happen.
    numbers
        Index into `files` of each sample, shape (samples,).
    files
        File of materials of every sample, including failed samples. Empty for a band that was read.
    summary
        Content of ``summary.json`` under the key ``band``.
    """

    times_s: Array
    nominal: Array
    quantiles: Array
    constants: tuple[str, ...]
    values: Array
    figure_names: tuple[Figure, ...]
    figures: Array
    numbers: NDArray[np.int64]
    files: tuple[str, ...]
    summary: Summary

    def __repr__(self) -> str:
        peak = self.summary["force_N"]["peak"]
        return (
            f"<tissue Band of {len(self.values)} samples, peak force {peak['p05']:.3g} to "
            f"{peak['p95']:.3g} N>"
        )


def require_band(
    scene: Scene,
    asked: int,
    workers: int | None,
    scheduler: str | None = None,
    *,
    each_run: bool = False,
) -> None:
    """Refuse invalid options of a band before the scene is run.

    Raises
    ------
    InputError
        If the number of samples is not between 16 and 65536, if processes are requested although no
        sample is run again or together with a scheduler, or if a run of each sample is requested
        for a scene that always needs it.
    """
    rounded(asked)
    is_linear = not why_not_linear(scene)
    if each_run and not is_linear:
        raise InputError(
            "each_run",
            "be left out of a scene whose loads cannot be reweighed",
            f"one where {why_not_linear(scene)}",
            "every sample is a run of its own",
        )
    if workers is not None:
        require_range("workers", workers, 1, 4096, "use one a core")
    for name, given in (("workers", workers), ("scheduler", scheduler)):
        if given is not None and is_linear and not each_run:
            raise InputError(
                name,
                "be left out where the geometry is recorded once and reweighed",
                given,
                "remove it, or ask for a run of each sample (each_run)",
            )
    if workers is not None and scheduler is not None:
        raise InputError(
            "workers", "be left out with a scheduler, which has its own", workers, "remove it"
        )


def band_of(
    scene: Scene,
    asked: int,
    *,
    seed: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    each_run: bool = False,
    compute: str = "cpu",
    cores: int | None = None,
    progress: Progress | None = None,
) -> Band:
    """Compute the band of a scene's loads and figures.

    Parameters
    ----------
    scene
        Simulated scene.
    asked
        Samples, rounded up to a power of two.
    seed
        Seed of the samples. Default: the scene's seed.
    workers
        Number of parallel processes, for scenes whose samples are separate runs.
    scheduler
        Address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``, instead of own
        processes.
    each_run
        Run every sample even where reweighing is enough. Needed for nonlinear figures such as
        temperature and stress.
    compute, cores, progress
        As for `tissue.simulate`.

    Raises
    ------
    InputError
        For the reasons that `require_band` lists, if no constant has a range, or if more than a
        tenth of the samples fail.
    """
    report = progress or silent
    require_band(scene, asked, workers, scheduler, each_run=each_run)
    seed = scene.seed if seed is None else seed
    if each_run or why_not_linear(scene):
        where = Workers(workers or 1, scheduler, compute)
        return _rerun(scene, asked, seed, workers=where, cores=cores, report=report)
    reweighed = Reweighed(record_loads(scene, compute=compute, cores=cores, progress=progress))
    ranges = reweighed.ranges
    record = reweighed.record
    _require_ranges(ranges)
    report("reweighing the loads", 0.0)
    values = ranges.x(normals(rounded(asked), len(ranges.names), seed=seed))
    figures = reweighed.figures(values)
    quantiles = reweighed.quantiles(values, tuple(LEVELS.values()))
    nominal = with_sizes(record.loads(reweighed.coefficients(reweighed.nominal())))
    report("computing Sobol indices", 0.5)
    indices = sobol_indices(
        lambda free: reweighed.figures(ranges.x(free)), ranges.groups, count=SOBOL_ROWS, seed=seed
    )
    files = tuple(sample_text(record.scene.constants, ranges.names, each) for each in values)
    summary = _about(asked, seed, HOW, ranges, indices) | intervals(LOADS, figures)
    summary |= {"samples": len(figures), "failed": 0, "problems": {}, "without": _without(scene)}
    numbers = np.arange(len(files))
    return Band(
        record.times_s,
        nominal,
        quantiles,
        ranges.names,
        values,
        LOADS,
        figures,
        numbers,
        files,
        summary,
    )


def _rerun(
    scene: Scene, asked: int, seed: int, *, workers: Workers, cores: int | None, report: Progress
) -> Band:
    """Compute a band whose samples are separate runs."""
    run = simulate(scene, compute=workers.compute, cores=cores, progress=report)
    trace = run.trace
    is_linear = not why_not_linear(scene)
    if density_prior(run.parts.notes.get("density law", "")) is not None and is_linear:
        raise InputError(
            "each_run must be left out where the density of an image varies within its law's "
            "band, which a file of "
            "materials cannot hold: reweigh the loads, whose density does vary"
        )
    nominal = with_sizes(
        np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")])
    )
    ranges = ranges_of(scene, trace.layer_names)
    _require_ranges(ranges)
    free = normals(rounded(asked), len(ranges.names), seed=seed)
    values = ranges.x(free)
    files = tuple(sample_text(scene.constants, ranges.names, each) for each in values)
    outcomes = dict(reruns(scene, files, workers=workers, report=report))
    problems = {
        sample_name(at, len(files)): each
        for at, each in sorted(outcomes.items())
        if isinstance(each, str)
    }
    if len(problems) > MOST_FAILED * len(files):
        reasons = "; ".join(f"{name}: {why}" for name, why in list(problems.items())[:3])
        raise InputError(
            "band",
            f"have samples of which at most {MOST_FAILED:.0%} fail",
            f"{len(problems)} of {len(files)} ({reasons})",
            "narrow the ranges in a file of materials",
        )
    kept = np.array([at for at, each in sorted(outcomes.items()) if not isinstance(each, str)])
    held = [each for _, each in sorted(outcomes.items()) if not isinstance(each, str)]
    times_s = trace["time_s"]
    quantiles, span = over_time([loads for loads, _ in held], times_s)
    names, figures = table_of([each for _, each in held])
    explaining = [
        at for at, name in enumerate(names) if name in LOADS or name[0].startswith(GREATEST)
    ]
    explained_names = tuple(names[at] for at in explaining)
    indices, explained = surrogate_indices(
        free[kept], figures[:, explaining], ranges.groups, seed=seed
    )
    summary = _about(
        asked, seed, HOW_ASKED if is_linear else HOW_RERUN, ranges, indices, explained_names
    ) | intervals(names, figures)
    summary |= {"samples": len(kept), "failed": len(problems), "problems": problems, "span": span}
    summary["surrogate_explains"] = {
        ".".join(name): float(share)
        for name, share in zip(explained_names, explained, strict=True)
        if np.isfinite(share)
    }
    last = quantiles.shape[1]
    return Band(
        times_s[:last],
        nominal[:last],
        quantiles,
        ranges.names,
        values[kept],
        names,
        figures,
        kept,
        files,
        summary,
    )


def _require_ranges(ranges: Ranges) -> None:
    if not ranges.names:
        raise InputError(
            "band", "be of a scene that rests on constants with a range", "none", "leave it out"
        )


def require_same(band: Band, loads: Array) -> None:
    """Check that a run has the loads that the band has at the nominal constants.

    Parameters
    ----------
    loads
        The run's force [N] and torque [N m] as the model gives them, shape (n, 6).

    Raises
    ------
    InputError
        If the run has fewer ticks, or loads differ by more than 1e-5 of the largest load.
    """
    if len(loads) < len(band.times_s):
        raise InputError(
            "band",
            "be of a whole run",
            f"one that was stopped after {len(loads)} of {len(band.times_s)} ticks",
            "run the scene again",
        )
    for first, columns in ((0, slice(0, 3)), (4, slice(3, 6))):
        nominal = band.nominal[:, first : first + 3]
        run = loads[: len(band.times_s), columns]
        if np.abs(nominal - run).max(initial=0.0) > SAME * np.abs(run).max(initial=0.0):
            raise InputError(
                "band",
                "be of a run whose scene is as it was",
                "other loads from the same scene",
                "run it again",
            )
