"""Sweep: runs of a scene with all combinations of given values: `tissue.sweep`."""

import json
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, counted, enumerated, require_range
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress
from meshes.base.text_tables import shown
from tissue.evaluation.assessment import path_note
from tissue.objects.comparison import PLOTTED, Comparison, shortened, split_formats, write_rows
from tissue.objects.html import figures_of, intervals_of, table_html
from tissue.objects.plots import Point, plot_figures
from tissue.objects.run import Run
from tissue.objects.simulate import simulate
from tissue.objects.trace import needed
from tissue.scene.load import DroppedKeyWarning, changed_scene, load_scene
from tissue.scene.part import removal_of
from tissue.scene.scene import Scene
from tissue.show.figures.figure import save
from tissue.simulation.builders.arguments import require_files, stated
from tissue.simulation.run_folder import PICTURE_FORMATS, read_summary, summary_of
from tissue.system.owned_folder import OwnedFolder
from tissue.system.progress import Bar, reporting
from tissue.system.workers import finished

if TYPE_CHECKING:
    import pandas

FILES = ("sweep.csv", *(f"sweep.{kind}" for kind in PICTURE_FORMATS), *PLOTTED)
"""Files that a sweep writes in addition to the folders of its runs."""
LONGEST_NAME = 24
"""Largest number of letters of a value in a folder name; longer values are numbered instead."""
MOST_RUNS = 10_000
"""Largest number of runs in a sweep; at 1 s for each run, the sweep takes three hours."""
FIRST_FIGURES = ("peak_force_N", "mean_force_N", "removed_mm3", "tick_median_us")
"""Summary values in the printed table; ``sweep.csv`` has all summary values."""
OF_MACHINE = ("tick_median_us", "tick_99_percent_us", "missed_deadlines")
NO_RESULTS = (*OF_MACHINE, "simulated_s", "left_region_s")
"""Summary values that do not describe the tool's loads; `Sweep.plot` does not draw them."""
RELATIVE_ROUNDING = 1e-9
"""Largest relative difference between summary values that is attributed to rounding."""


@dataclass(frozen=True)
class SweptRun:
    """One run of a sweep.

    Attributes
    ----------
    name
        Name of the run's folder, formed from the swept keys and their values.
    values
        Values of the swept keys.
    path
        Folder of the run.
    problem
        Error message if the run ended with an error or its scene is invalid; empty for a finished
        run.
    scene
        Scene of the run; None if the scene is invalid with these values.
    """

    name: str
    values: dict[str, object]
    path: Path
    problem: str = ""
    scene: Scene | None = None

    @cached_property
    def figures(self) -> dict[str, float]:
        """Summary values, keyed by names with units; empty for a run with a problem."""
        return {} if self.problem else figures_of(read_summary(self.path))

    @cached_property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """90 % intervals of the summary values that have an uncertainty band."""
        return {} if self.problem else intervals_of(read_summary(self.path))

    @cached_property
    def note(self) -> str:
        """Reason why the tool did not reach the end of its path; empty if it reached the end.

        The reason is also empty for a run with a problem.
        """
        return "" if self.problem else path_note(read_summary(self.path))

    def open(self) -> Run:
        """Read the run from its folder."""
        return Run.load(self.path)


class Sweep:
    """Results of running a scene with every combination of the given values.

    Attributes
    ----------
    keys
        Scene keys whose values were varied.
    runs
        All runs, including runs with a problem.
    """

    def __init__(self, keys: list[str], runs: list[SweptRun]) -> None:
        self.keys = keys
        self.runs = runs

    @property
    def finished(self) -> list[SweptRun]:
        """Runs without a problem."""
        return [each for each in self.runs if not each.problem]

    @property
    def failures(self) -> dict[str, str]:
        """Error messages of the runs with a problem, keyed by the name of the run."""
        return {each.name: each.problem for each in self.runs if each.problem}

    @property
    def notes(self) -> dict[str, str]:
        """Reason why the tool of a run did not reach the end of its path, keyed by run name."""
        return {each.name: f"the path is {each.note}" for each in self.runs if each.note}

    @property
    def figure_names(self) -> list[str]:
        """Names of the summary values of the runs, with units."""
        return list(dict.fromkeys(name for each in self.runs for name in each.figures))

    def rows(self) -> tuple[list[str], list[list[object]]]:
        """Return titles and rows of a table with one row per run.

        A row has the swept values, the summary values, the problem, the folder and the note of the
        run.
        """
        names = self.figure_names
        rows = []
        for each in self.runs:
            figures = [each.figures.get(name) for name in names]
            rows.append([*each.values.values(), *figures, each.problem, each.name, each.note])
        return [*self.keys, *names, "problem", "run", "note"], rows

    def texts(self) -> tuple[list[str], list[list[str]]]:
        """Return column titles and rows of a short table: swept values and main summary values."""
        names = [name for name in FIRST_FIGURES if name in self.figure_names]
        rows = []
        for each in self.runs:
            figures = (each.figures.get(name) for name in names)
            shown = ["" if value is None else f"{value:.4g}" for value in figures]
            rows.append([*map(str, each.values.values()), *shown])
        return [*(key.rpartition(".")[2] for key in self.keys), *names], rows

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of `rows`; raises `InputError` if pandas is not installed."""
        titles, rows = self.rows()
        return needed("pandas", extra="pandas").DataFrame(rows, columns=titles)

    def compare(self) -> Comparison:
        """Compare the finished runs; raises `InputError` if fewer than two runs are finished."""
        return Comparison({each.name: each.open() for each in self.finished})

    def plot(self, figures: list[str] | None = None) -> NDArray[np.object_]:
        """Plot summary values over the first swept key, with one line per value of the second key.

        If the runs have uncertainty bands, bars show the 90 % intervals.

        Parameters
        ----------
        figures
            Names from `figure_names`. The default is the summary values that differ between the
            runs.

        Returns
        -------
        Matplotlib axes, one for each summary value, shape (figures,).

        Raises
        ------
        InputError
            If there is nothing to plot, or the number of swept keys is not 1 or 2.
        """
        names = self._differing() if figures is None else figures
        known = self.figure_names
        if unknown := [name for name in names if name not in known]:
            raise InputError(
                "figures", f"be among {enumerated(known)}", unknown[0], "choose from these names"
            )
        if not names or len(self.keys) not in (1, 2):
            raise InputError(
                "plot",
                "have one or two keys, and at least one figure that differs between runs",
                f"{counted(len(self.keys), 'key')} and {counted(len(names), 'figure')}",
                "read the results from the table of the sweep",
            )
        over, *second = self.keys
        lines: dict[str, list[Point]] = {}
        places, *labels = (
            shortened(key, [each.values[key] for each in self.finished]) for key in self.keys
        )
        for at, each in enumerate(self.finished):
            label = str(labels[0][at]) if labels else ""
            lines.setdefault(label, []).append((places[at], each.figures, each.intervals))
        return plot_figures(lines, names, over=over, title="".join(second))

    def _differing(self) -> list[str]:
        """Return names of summary values that differ between runs by more than rounding."""
        differing = []
        for name in self.figure_names:
            values = [each.figures.get(name, np.nan) for each in self.finished]
            if name not in NO_RESULTS and not np.allclose(
                values, values[0], rtol=RELATIVE_ROUNDING, atol=0.0
            ):
                differing.append(name)
        return differing

    def write(self, out: Path, formats: Sequence[str] = ()) -> None:
        """Write ``sweep.csv`` and, if several runs are finished, plots and traces of these runs.

        For the formats, see `tissue.objects.comparison.Comparison.save`.
        """
        from matplotlib import pyplot

        write_rows(out / "sweep.csv", *self.rows())
        if len(self.finished) > 1:
            self.compare().write_plotted(out, formats=formats)
        if len(self.keys) in (1, 2) and self._differing():
            panels = self.plot()
            for kind in split_formats(formats)[0]:
                save(panels[0].figure, out / f"sweep.{kind}")
            pyplot.close(panels[0].figure)

    def __repr__(self) -> str:
        keys = " and ".join(self.keys)
        return f"<sweep of {keys}: {len(self.finished)} of {len(self.runs)} runs finished>"

    def _repr_html_(self) -> str:
        titles, rows = self.texts()
        shown = table_html(rows, titles=titles, caption=repr(self).strip("<>"))
        for title, texts in (("problem", self.failures), ("note", self.notes)):
            if texts:
                shown += table_html(texts.items(), titles=("run", title))
        return f"<div>{shown}</div>"


@suggests_arguments
def sweep(
    scene: Scene | str | Path,
    changes: Mapping[str, Iterable[object]],
    *,
    out: str | Path,
    workers: int = 1,
    compute: str = "cpu",
    cores: int | None = None,
    pictures: bool = False,
    formats: Iterable[str] = (),
    band: int | None = None,
    overwrite: bool = False,
    allow_unstable: bool = False,
    progress: Bar = None,
) -> Sweep:
    """Run a scene with all combinations of given values, each run in its own folder.

    Finished runs in the folder are kept. The same call therefore continues a sweep that was
    stopped. If a later call has additional values, only the new combinations are run. A combination
    that cannot be run is listed in `Sweep.failures`, and the other runs continue.

    Parameters
    ----------
    scene
        A scene, a built-in name or a TOML file.
    changes
        Values of each varied scene key: ``{"motion.feed_mm_s": [2.0, 4.0], "tool.spin_rpm": [800,
        1600]}``.
    out
        Folder of the runs. ``sweep.csv`` and ``sweep.png`` contain the results of each run, and
        ``compare.png`` shows the loads.
    workers
        Number of parallel processes. With several processes, each process uses one core unless
        `cores` is given, and ticks take longer. A script that uses several processes must have its
        statements below ``if __name__ == "__main__":``. Materials, tools and other parts that the
        script registers above the line ``if __name__ == "__main__":`` are available in the
        processes.
    compute, cores, allow_unstable
        As for `tissue.simulate`.
    pictures
        Whether to draw pictures of each run. Their format is the first picture format in `formats`.
    formats
        Formats of the pictures: png, svg or pdf; default png. Formats of the table
        ``traces.FORMAT``, which holds the traces of all runs: parquet, npz, mat or h5.
    band
        Number of samples of the material constants, as for `Run.band`. If it is given, each run has
        an uncertainty band, and ``compare.png`` shows the bands. Finished runs without a band are
        run again.
    overwrite
        Whether to run finished runs again.
    progress
        As for `tissue.simulate`.

    Raises
    ------
    InputError
        If the scene is invalid in all combinations that contain a certain value, or if a file is
        missing. It is also raised if the folder holds runs of another scene under the names of this
        sweep's runs, or if a format or the number of samples is invalid.
    """
    out = Path(out)
    formats = tuple(formats)
    kinds, _ = split_formats(formats)
    drawn = kinds[0] if pictures else False
    if band is not None:
        from tissue.fitting.bands.sample import rounded

        rounded(band)
    workers = int(require_range("workers", workers, 1, 4096, "use one for each core"))
    runs = planned(scene, changes, out)
    # Runs side by side already use all cores.
    if cores is None and workers > 1:
        cores = 1
    run = partial(
        _run,
        pictures=drawn,
        band=band,
        compute=compute,
        cores=cores,
        allow_unstable=allow_unstable,
    )
    with OwnedFolder(out, "sweep", (), shared=FILES), reporting(progress) as report:
        left = _unfinished(runs, band=band, overwrite=overwrite)
        problems = dict(_results(run, left, workers=min(workers, len(left)), report=report))
        runs = [replace(each, problem=problems.get(each.name, each.problem)) for each in runs]
        found = Sweep(list(runs[0].values), runs)
        report("drawing pictures", 1.0)
        found.write(out, formats)
    return found


def planned(
    scene: Scene | str | Path, changes: Mapping[str, Iterable[object]], out: Path
) -> list[SweptRun]:
    """Return the planned runs of a sweep; the value of the last key varies fastest.

    Raises
    ------
    InputError
        If a key has no values, if there are more than `MOST_RUNS` combinations, or if all
        combinations with a certain value are invalid.
    """
    given = {key: _listed(key, values) for key, values in changes.items()}
    count = prod(len(values) for values in given.values())
    require_range("number of runs", count, 1, MOST_RUNS, "give fewer values")
    fixed = {key: values[0] for key, values in given.items() if len(values) == 1}
    swept = {key: values for key, values in given.items() if len(values) > 1}
    base = scene if isinstance(scene, Scene) else load_scene(scene)
    words = [_words(key, values, swept) for key, values in swept.items()]
    found: dict[str, SweptRun] = {}
    for combination, named in zip(product(*swept.values()), product(*words), strict=True):
        name = ",".join(named) or base.name
        values = dict(zip(swept, combination, strict=True))
        each = SweptRun(name, values, out / name)
        try:
            new, dropped = changed_scene(base, fixed | values)
            if dropped:
                # Level 4 is the caller of `sweep`, which has a decorator.
                warnings.warn(removal_of(dropped), DroppedKeyWarning, stacklevel=4)
            require_files(new)
            found[name] = replace(each, scene=new)
        except InputError as refused:
            found[name] = replace(each, problem=str(refused))
    by_value: dict[tuple[str, str], list[str]] = {}
    for each in found.values():
        # Without swept keys, there is a single run.
        for key, value in each.values.items() or [("", "")]:
            by_value.setdefault((key, repr(value)), []).append(each.problem)
    for problems in by_value.values():
        # A value that is refused in all its runs is a typing error.
        if all(problems):
            raise InputError(problems[0])
    return list(found.values())


def _listed(key: str, values: Iterable[object]) -> list[object]:
    """Return the values of a key as a list of plain Python values; arrays are converted."""
    found: list[object] = []
    if isinstance(values, Iterable) and not isinstance(values, str | Mapping):
        found = list(islice(values, MOST_RUNS + 1))
    if not found:
        raise InputError(key, "be given as a list of values", values, "use for example [1.0, 2.0]")
    found = [each.tolist() if isinstance(each, np.generic | np.ndarray) else each for each in found]
    for index, each in enumerate(found):
        if each in found[:index]:
            raise InputError(
                key, "have different values", f"{shown(each)} twice", "give each value once"
            )
    return found


def _words(key: str, values: Sequence[object], swept: Mapping[str, object]) -> list[str]:
    """Return parts of folder names for the values of a key.

    A part is a text such as ``feed_mm_s=2``. The table of the key is left out unless two swept keys
    differ only in the table.
    """
    last = key.rpartition(".")[2]
    short = last if sum(other.rpartition(".")[2] == last for other in swept) == 1 else key
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    words = [re.sub(r"[^\w.+-]+", "-", text) for text in texts]
    nested = any(isinstance(value, list | tuple | dict) for value in values)
    usable = all(0 < len(word) <= LONGEST_NAME for word in words) and len({*words}) == len(words)
    if nested or not usable:
        words = [f"no{number}" for number in range(1, len(words) + 1)]
    return [f"{short}={word}" for word in words]


def _unfinished(
    runs: list[SweptRun], *, overwrite: bool, band: int | None = None
) -> list[tuple[SweptRun, bool]]:
    """Return the runs to be done, each with True if it may replace an earlier run in its folder.

    Raises
    ------
    InputError
        If a folder holds a run of another scene.
    """
    left: list[tuple[SweptRun, bool]] = []
    for each in runs:
        if each.scene is None:
            continue
        begun = (each.path / "scene.toml").is_file()
        if begun and not overwrite and not _holds(each.path, each.scene):
            raise InputError(
                "out",
                "contain only runs of this scene",
                f"a run of another scene in {each.path}",
                "pass --overwrite (overwrite=True in Python) to replace it or choose another --out",
            )
        summary = summary_of(each.path)
        has_band = band is None or summary.get("band", {}).get("asked") == band
        if overwrite or not begun or summary.get("status") != "complete" or not has_band:
            left.append((each, overwrite or begun))
    return left


def _holds(path: Path, scene: Scene) -> bool:
    """Return whether the folder holds a run of this scene.

    In a scene with a fidelity requirement, the requirement is first replaced by the settings that
    meet it.
    """
    from tissue.evaluation.charts.frontier import with_fidelity

    try:
        return load_scene(path / "scene.toml") == with_fidelity(scene)[0]
    except InputError:
        return False


def _results(
    run: "partial[str]", left: list[tuple[SweptRun, bool]], *, workers: int, report: Progress
) -> Iterator[tuple[str, str]]:
    """Run the remaining runs; yield each run's name and error message (empty without an error)."""
    total = len(left)
    jobs = [
        (each.path, each.scene.model_dump_json(exclude_unset=True), replaces)
        for each, replaces in left
        if each.scene is not None
    ]
    if workers <= 1:
        for number, job in enumerate(jobs):
            share = partial(_share, report, job[0].name, number, total)
            yield job[0].name, run(job, progress=share)
        return
    done = 0
    same = partial(_same_share, report)
    report(f"0 of {total} runs are done", 0.0)
    for batch in finished(run, jobs, workers=workers, scheduler=None, report=same):
        for (path, *_), problem in batch:
            yield path.name, str(problem)
        done += len(batch)
        report(f"{done} of {total} runs are done", done / total)


def _share(report: Progress, name: str, number: int, total: int, doing: str, share: float) -> None:
    """Report the progress of one run as progress of the sweep."""
    report(f"run {number + 1} of {total}, {name}: {doing}", (number + share) / total)


def _same_share(report: Progress, doing: str, share: float = 1.0) -> None:
    """Report a message with the completed share 1, independent of the given share."""
    report(doing, 1.0)


def _run(
    job: tuple[Path, str, bool],
    progress: Bar = False,
    *,
    pictures: bool | str,
    band: int | None,
    **settings: Any,
) -> str:
    """Simulate and save one run; return the message of an error, or an empty text.

    `job` contains the folder of the run, its scene as JSON, and whether the run may replace an
    earlier run in the folder.
    """
    path, scene, replaces = job
    # The stages of a band count from zero again, which would move the bar back.
    sampling = partial(_same_share, progress) if callable(progress) else progress
    try:
        read = stated(Scene, json.loads(scene))
        run = simulate(read, out=path, overwrite=replaces, progress=progress, **settings)
        run.save(path, pictures=pictures)
        if band is not None:
            there = {"compute": settings["compute"], "cores": settings["cores"]}
            run.band(band, pictures=pictures, progress=sampling, **there)
    except InputError as refused:
        return str(refused)
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    return ""
