"""Uncertainty band of a run: loads and figures when the constants vary within their ranges.

A figure is a number that summarises a run, such as the peak force. The module also computes the
influence of each constant on the figures, and reads and writes the files of a band.
"""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import PRESENT, InputError, require_range
from meshes.base.file_limits import require_regular
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file, write_text
from tissue.fitting.bands.sample import (
    Ranges,
    normals,
    ranges_of,
    rounded,
    sample_name,
    sample_text,
    sobol_indices,
    surrogate_indices,
)
from tissue.fitting.bands.sample_loads import (
    CHANNELS,
    LARGEST_PREFIX,
    LEVELS,
    LOADS,
    Figure,
    Reweighed,
    Workers,
    density_prior,
    intervals,
    loads_of,
    over_time,
    reruns,
    table_of,
    with_sizes,
)
from tissue.scene.anatomy import Tooth
from tissue.scene.scene import Scene
from tissue.show.figures.band_pictures import draw_band, draw_sobol
from tissue.simulation.load_record import record_loads, why_not_linear
from tissue.simulation.run_folder import Summary, added_to_run, read_summary
from tissue.simulation.simulate import simulate
from tissue.system.owned_folder import listed_files

SAME_EVERYWHERE = "does not vary with the constants, because the path is given"
NEEDS_RUNS = "depends on the constants, but only runs of all samples give a band (--each-run)"
HOW = (
    "the geometry was recorded once and multiplied by the constants of each sample, because the "
    "path is given"
)
HOW_RERUN = (
    "every sample was run, because the force moves the tool or is not linear in the constants"
)
HOW_ASKED = "every sample was run, as requested"
MOST_FAILED = 0.1
"""Largest share of samples that may fail.

If more samples failed, the ends of a 90 % band would describe only the remaining samples.
"""
LOAD_TOLERANCE = 3e-3
"""Largest accepted difference of a run's loads from the nominal loads of its band.

The difference is relative to the peak load. It is not zero, because the loads of a band are
interpolated between tabulated chip thicknesses.
"""
SOBOL_ROWS = 512
"""Number of rows of each of the two random matrices from which the Sobol indices are computed.

For a milling run, the computation with 512 rows takes 1 s. The indices then differ by at most 0.03
from the indices with 8192 rows.
"""


@dataclass(frozen=True, eq=False)
class Band:
    """Uncertainty band of a run.

    Attributes
    ----------
    times_s
        Times of the ticks [s], shape (n,).
    nominal
        Loads on the tool at the nominal values of the constants, shape (n, 8). The components are
        `tissue.fitting.bands.sample_loads.CHANNELS`.
    quantiles
        Quantiles of the loads at the five `LEVELS`, shape (5, n, 8).
    constants, values
        Names of the constants that vary, and their values in each sample, shape (samples, p).
    figure_names
        Names of the summary values, see `tissue.fitting.bands.sample_loads.Figure`.
    figures
        Summary values of each sample, shape (samples, figures). A value that a sample does not have
        is NaN, for example the time of an event that does not happen.
    numbers
        Index into `files` of each sample that did not fail, shape (samples,).
    files
        Text of the materials file of each sample. Failed samples are included. Empty if the band
        was read from a folder.
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
    numbers: Ints
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
        If the number of samples is not between 16 and 65536, or an option has no effect. `workers`
        has no effect if `scheduler` is given, or if the loads of all samples follow from one run.
        `each_run` has no effect for a scene whose samples must always be run separately.
    """
    rounded(asked)
    if workers is not None:
        # more processes than any machine has cores: a typing error
        require_range("workers", workers, 1, 4096, "use one for each core")
    is_always_rerun = bool(why_not_linear(scene))
    if each_run and is_always_rerun:
        raise InputError(
            "each_run",
            "be left out for a scene whose samples are always separate runs",
            PRESENT,
            "remove it",
        )
    is_rerun = is_always_rerun or each_run
    if workers is not None and scheduler is not None and is_rerun:
        raise InputError("workers", "be left out with a scheduler", PRESENT, "remove it")
    for name, value in (("workers", workers), ("scheduler", scheduler)):
        if value is not None and not is_rerun:
            raise InputError(
                name,
                "be left out if the loads of all samples follow from one run",
                PRESENT,
                "remove it, or set each_run",
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
    progress: Progress = silent,
) -> Band:
    """Compute the uncertainty band of a scene's loads and summary values.

    Parameters
    ----------
    scene
        Simulated scene.
    asked
        Number of samples. It is rounded up to a power of two.
    seed
        Seed of the samples. Default: the scene's seed.
    workers
        Number of parallel processes, for scenes whose samples are separate runs.
    scheduler
        Address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``. Its workers run the
        samples instead of local processes.
    each_run
        True to run every sample, even if the loads of all samples can be computed from the recorded
        loads of one run. Needed for summary values that are not linear in the constants, such as
        temperature and stress.
    compute, cores, progress
        As for `tissue.simulate`.

    Raises
    ------
    InputError
        If `require_band` raises an error, no constant has a range, or more than a tenth of the
        samples fail.
    """
    require_band(scene, asked, workers, scheduler, each_run=each_run)
    seed = scene.seed if seed is None else seed
    if each_run or why_not_linear(scene):
        where = Workers(workers or 1, scheduler, compute)
        return _rerun(scene, asked, seed, workers=where, cores=cores, report=progress)
    reweighed = Reweighed(record_loads(scene, compute=compute, cores=cores, progress=progress))
    ranges = reweighed.ranges
    record = reweighed.record
    values, files = _samples(scene, ranges, asked, seed)[1:]
    progress("reweighing the loads", 0.0)
    figures = reweighed.figures(values)
    progress("computing Sobol indices", 0.5)
    indices = sobol_indices(
        lambda free: reweighed.figures(ranges.x(free)), ranges.groups, count=SOBOL_ROWS, seed=seed
    )
    names = ["removed_mm3", "contact_share"] + ["keep_clear"] * (scene.keep_clear is not None)
    without = dict.fromkeys([*names, "break_through", "events"], SAME_EVERYWHERE)
    # temperature and stress are not linear in the coefficients, so that they cannot be reweighed
    if scene.heat:
        is_tooth = isinstance(scene.anatomy, Tooth)
        warmed = ["greatest_pulp_rise_K"] if is_tooth else ["greatest_bone_rise_K", "bone_heat"]
        without |= dict.fromkeys((*warmed, "events"), NEEDS_RUNS)
    if scene.stress is not None:
        without["stress"] = NEEDS_RUNS
    summary = {"asked": asked, "seed": seed, "how": HOW, **_about(ranges, indices, LOADS)}
    summary |= intervals(LOADS, figures)
    summary |= {"samples": len(figures), "failed": 0, "problems": {}, "without": without}
    return Band(
        record.times_s,
        with_sizes(record.loads(reweighed.coefficients(reweighed.nominal()))),
        reweighed.quantiles(values, tuple(LEVELS.values())),
        ranges.names,
        values,
        LOADS,
        figures,
        np.arange(len(files)),
        files,
        summary,
    )


def _samples(
    scene: Scene, ranges: Ranges, asked: int, seed: int
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return standard normal numbers, constants and materials files of all samples."""
    if not ranges.names:
        raise InputError(
            "band",
            "be left out for a scene whose constants have no range",
            PRESENT,
            "remove it",
        )
    free = normals(rounded(asked), len(ranges.names), seed=seed)
    values = ranges.x(free)
    return free, values, tuple(sample_text(scene.constants, ranges.names, x) for x in values)


def _about(ranges: Ranges, indices: Array, figures: tuple[Figure, ...]) -> Summary:
    """Return a summary of the constants, and the Sobol indices of each summary value.

    The indices are keyed by the group of constants. Summary values that do not vary are left out.
    """
    constants = {
        name: {"value": prior.value, "low": prior.low, "high": prior.high}
        for name, prior in zip(ranges.names, ranges.priors, strict=True)
    }
    sobol: Summary = {}
    for column, figure in enumerate(figures):
        # a constant figure has no variance, and its indices are not finite
        if not np.isfinite(indices[..., column]).all():
            continue
        groups = sobol[".".join(figure)] = {}
        for row, group in enumerate(ranges.group_names):
            (first, *first_90), (total, *total_90) = indices[:, :, row, column].tolist()
            groups[group] = {
                "first": first,
                "first_90": first_90,
                "total": total,
                "total_90": total_90,
            }
    return {"constants": constants, "sobol": sobol}


def _rerun(
    scene: Scene, asked: int, seed: int, *, workers: Workers, cores: int | None, report: Progress
) -> Band:
    """Compute a band whose samples are separate runs."""
    run = simulate(scene, compute=workers.compute, cores=cores, progress=report)
    is_linear = not why_not_linear(scene)
    if density_prior(run.parts.notes.get("density law", "")) is not None and is_linear:
        raise InputError(
            "each_run",
            "be left out if the density law of the image is uncertain",
            PRESENT,
            (
                "remove it, because a file of materials for each run cannot contain an uncertain "
                "density"
            ),
        )
    ranges = ranges_of(scene, run.trace.layer_names)
    free, values, files = _samples(scene, ranges, asked, seed)
    outcomes = sorted(dict(reruns(scene, files, workers=workers, report=report)).items())
    problems = {sample_name(at, len(files)): each for at, each in outcomes if isinstance(each, str)}
    if len(problems) > MOST_FAILED * len(files):
        # samples often fail for the same reason, so three examples are enough
        reasons = "; ".join(f"{name}: {why}" for name, why in list(problems.items())[:3])
        raise InputError(
            "band",
            f"have at most {MOST_FAILED:.0%} failed samples",
            f"{len(problems)} failed samples of {len(files)} ({reasons})",
            "narrow the ranges of the constants in a file of materials",
        )
    kept = np.array([at for at, each in outcomes if not isinstance(each, str)])
    held = [each for _, each in outcomes if not isinstance(each, str)]
    times_s = run.trace["time_s"]
    quantiles, span = over_time([loads for loads, _ in held], times_s)
    names, figures = table_of([each for _, each in held])
    places = [
        at for at, name in enumerate(names) if name in LOADS or name[0].startswith(LARGEST_PREFIX)
    ]
    explained_names = tuple(names[at] for at in places)
    indices, explained = surrogate_indices(free[kept], figures[:, places], ranges.groups, seed=seed)
    how = HOW_ASKED if is_linear else HOW_RERUN
    summary = {"asked": asked, "seed": seed, "how": how, **_about(ranges, indices, explained_names)}
    summary |= intervals(names, figures)
    summary |= {"samples": len(kept), "failed": len(problems), "problems": problems, "span": span}
    summary["surrogate_explains"] = {
        ".".join(name): float(share)
        for name, share in zip(explained_names, explained, strict=True)
        if np.isfinite(share)
    }
    last = quantiles.shape[1]
    return Band(
        times_s[:last],
        loads_of(run)[:last],
        quantiles,
        ranges.names,
        values[kept],
        names,
        figures,
        kept,
        files,
        summary,
    )


def require_same(band: Band, loads: Array) -> None:
    """Check that the loads of a run equal the band's nominal loads.

    Parameters
    ----------
    loads
        Force [N] and torque [N m] on the tool, shape (n, 6), as computed by the model in the run.

    Raises
    ------
    InputError
        If the run has fewer ticks than the band, or a load differs by more than the relative
        tolerance `LOAD_TOLERANCE`.
    """
    count = len(band.times_s)
    if len(loads) >= count:
        run = with_sizes(loads[:count])
        # columns 3 and 7 are the sizes of force and torque; each scales its own components
        scales = np.repeat(np.abs(run[:, [3, 7]]).max(axis=0, initial=0.0), 4)
        if (np.abs(band.nominal - run) <= LOAD_TOLERANCE * scales).all():
            return
    raise InputError(
        "band",
        "belong to a complete run of the unchanged scene",
        f"a run of {len(loads)} ticks and a band of {count} ticks, with different loads",
        "run the scene again",
    )


OVER_TIME = "band.csv"
SAMPLES = "band/samples.csv"
SEPARATOR = "|"
"""Separator between the parts of a summary value's name in the header of a table of samples.

The separator is not a dot, because the name of a layer or the text of an event may contain a dot.
"""


def save_band(band: Band, folder: Path, *, kind: str | None) -> None:
    """Write a band into the folder of its run. An earlier band in the folder is replaced.

    `kind` is the format of the pictures. If it is None, no pictures are drawn.

    Raises
    ------
    InputError
        If the folder holds no run, or another process writes to it.
    """
    summary = read_summary(folder)
    with added_to_run(folder):
        for old in _earlier_samples(folder):
            old.unlink()
        names = [f"{channel}_{level}" for channel in CHANNELS for level in LEVELS]
        quantiles = np.moveaxis(band.quantiles, 0, 2).reshape(len(band.times_s), -1)
        rows = np.column_stack([band.times_s, band.nominal, quantiles])
        _write(folder / OVER_TIME, ["time_s", *CHANNELS, *names], rows)
        held = (folder / SAMPLES).parent
        held.mkdir(exist_ok=True)
        for number, text in enumerate(band.files):
            write_text(held / sample_name(number, len(band.files)), text)
        figures = [SEPARATOR.join(name) for name in band.figure_names]
        table = np.column_stack([band.numbers, band.values, band.figures])
        _write(folder / SAMPLES, ["sample", *band.constants, *figures], table)
        if kind is not None:
            (folder / "pictures").mkdir(exist_ok=True)
            title = str(summary["scene"])
            draw_band(
                band.times_s,
                band.nominal,
                band.quantiles,
                folder / "pictures" / f"band.{kind}",
                title=title,
            )
            draw_sobol(
                band.summary["sobol"], folder / "pictures" / f"band_sobol.{kind}", title=title
            )
        with whole_file(folder / "summary.json") as temporary:
            temporary.write_text(
                json.dumps(summary | {"band": band.summary}, indent=2) + "\n", "utf-8"
            )


def _earlier_samples(folder: Path) -> list[Path]:
    """Return the files of an earlier band's samples."""
    held = (folder / SAMPLES).parent
    names = sorted(folder / name for name in listed_files(folder).get("run", ()))
    return [path for path in names if path.parent == held and path.suffix == ".toml"]


def read_band(folder: Path) -> Band:
    """Read the band in a run's folder.

    Raises
    ------
    InputError
        If there is no band, or a file is damaged.
    """
    held = read_summary(folder).get("band")
    if held is None:
        raise InputError(
            "run", "have a band", f"none in {folder}", "compute one with run.band(200)"
        )
    (_, times) = _read(folder / OVER_TIME)
    (header, samples) = _read(folder / SAMPLES)
    constants = tuple(held["constants"])
    width = 1 + len(constants)
    nominal = times[:, 1 : 1 + len(CHANNELS)]
    quantiles = times[:, 1 + len(CHANNELS) :]
    if quantiles.shape[1] != len(CHANNELS) * len(LEVELS) or tuple(header[1:width]) != constants:
        raise InputError(
            "band.csv",
            "be unchanged since run.band wrote it",
            f"a changed file in {folder}",
            "compute the band again",
        )
    over = np.moveaxis(quantiles.reshape(len(times), len(CHANNELS), len(LEVELS)), 2, 0)
    names = tuple(tuple(name.split(SEPARATOR)) for name in header[width:])
    numbers = samples[:, 0].astype(np.int64)
    return Band(
        times[:, 0],
        nominal,
        over,
        constants,
        samples[:, 1:width],
        names,
        samples[:, width:],
        numbers,
        (),
        held,
    )


def _write(path: Path, names: list[str], rows: Array) -> None:
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(names)
        np.savetxt(file, rows, fmt="%.9g", delimiter=",")


def _read(path: Path) -> tuple[list[str], Array]:
    require_regular(path)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return next(csv.reader(file)), np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, StopIteration):
        raise InputError(
            path.name, "be a table of numbers", f"other content in {path}", "compute the band again"
        ) from None
