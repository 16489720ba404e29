"""Comparison of several runs: differences of their scenes and figures, and plotted forces."""

import csv
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from tissue.evaluation.assessment import path_note
from tissue.objects.html import figures_of, table_html
from tissue.objects.run import Run
from tissue.objects.trace import needed
from tissue.scene.scene import Scene
from tissue.system.owned_folder import OwnedFolder, require_folder

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from numpy.typing import NDArray

__all__ = ["Comparison", "Over", "compare", "entries_of", "write_rows"]


Over = Literal["time", "depth"]
FILES = ("compare.csv", "compare.png")
KIND = "comparison"
"""Kind of output in the marker of the folder."""
LONGEST_VALUE = 60
"""Largest number of characters of a scene's entry in a line."""
OUTSIDE = {"tissue": "version of tissue", "compute": "compute device", "machine": "machine"}
"""Entries of a summary, other than the scene, that affect a run or its ticks."""


class Comparison:
    """Comparison of runs; the first run is the reference for the others.

    Parameters
    ----------
    runs
        At least two runs, by name.

    Attributes
    ----------
    runs
        The runs by name.
    figures
        Figures of each run: peak and mean force, removed volume and so on, with the unit in each
        name.
    scene_differences
        Keys of the scenes that differ, with the value of each run; None for a missing value.
    notes
        Other obstacles to the comparison, a sentence each.
    """

    def __init__(self, runs: Mapping[str, Run]) -> None:
        if len(runs) < 2:
            raise InputError("compare", "be given at least two runs", len(runs), "name another run")
        self.runs = dict(runs)
        self.figures = {name: figures_of(run.summary) for name, run in runs.items()}
        self.scene_differences = _differences([run.scene for run in runs.values()])
        self.notes = list(_notes(self.runs))

    def rows(self) -> tuple[list[str], list[tuple[str, list[float | None]]]]:
        """Return titles, and for each figure the values of all runs.

        The first run's value comes first. Each other run adds its value, the difference from the
        first, and the ratio of the difference to the first.
        """
        first, *others = self.runs
        titles = [first]
        for name in others:
            titles += [name, f"{name} - {first}", f"{name} / {first} - 1"]
        found = []
        for figure in dict.fromkeys(figure for one in self.figures.values() for figure in one):
            base = self.figures[first].get(figure)
            values = [base]
            for name in others:
                value = self.figures[name].get(figure)
                apart = None if value is None or base is None else value - base
                # A ratio to 0 does not exist.
                values += [value, apart, None if apart is None or not base else apart / base]
            found.append((figure, values))
        return titles, found

    def texts(self) -> tuple[list[str], list[list[str]]]:
        """Return titles and rows of a readable table of figures.

        Values of other runs are followed by their relative difference from the first run.
        """
        _, rows = self.rows()
        found = []
        for figure, (base, *others) in rows:
            cells = [_number(base)]
            for value, share in zip(others[::3], others[2::3], strict=True):
                cells.append(_number(value) + (f" ({100.0 * share:+.3g} %)" if share else ""))
            found.append([figure, *cells])
        return ["figure", *self.runs], found

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of `rows` as a DataFrame, with one row per figure.

        The differences of the scenes are in its ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        titles, rows = self.rows()
        table = needed("pandas", extra="pandas").DataFrame(
            [values for _, values in rows],
            index=[figure for figure, _ in rows],
            columns=titles,
            dtype=float,
        )
        table.attrs["scene_differences"] = self.scene_differences
        return table.rename_axis(index="figure")

    def plot(self, over: Over = "time") -> "NDArray[np.object_]":
        """Draw the size of force and torque of all runs, and the difference of their forces.

        The difference is from the first run's force.

        Parameters
        ----------
        over
            ``time``, or ``depth`` of the tool's tip from its first contact, in the first descent.

        Returns
        -------
        The panels, shape (3,).

        Raises
        ------
        InputError
            If a run never touches, and so has no depth.
        """
        from tissue.objects.plots import overlay

        return overlay({name: run.trace for name, run in self.runs.items()}, over=over)

    def save(self, out: str | Path, *, over: Over = "time", overwrite: bool = False) -> list[Path]:
        """Write ``compare.csv`` and ``compare.png`` into a folder; return them.

        Raises
        ------
        InputError
            If the folder holds another comparison.
        """
        from matplotlib import pyplot

        from tissue.show.figures.figure import save

        out = Path(out)
        require_folder(out, KIND, FILES, overwrite=overwrite)
        panels = self.plot(over)
        titles, rows = self.rows()
        with OwnedFolder(out, KIND, FILES, overwrite=overwrite):
            lines = [[figure, *values] for figure, values in rows]
            write_rows(out / FILES[0], ["figure", *titles], lines)
            save(panels[0].figure, out / FILES[1])
        pyplot.close(panels[0].figure)
        return [out / name for name in FILES]

    def lines(self) -> list[str]:
        """Return the differences other than figures, a line each."""
        found = [
            f"{key}: {_each(self.runs, values)}" for key, values in self.scene_differences.items()
        ]
        return [*(found or ["the scenes are the same"]), *self.notes]

    def __repr__(self) -> str:
        return f"<comparison of {', '.join(self.runs)}: {len(self.scene_differences)} keys differ>"

    def _repr_html_(self) -> str:
        titles, rows = self.texts()
        keys = [[key, *map(_short, values)] for key, values in self.scene_differences.items()]
        shown = table_html(rows, titles=titles)
        if keys:
            caption = "keys of the scenes that differ"
            shown += table_html(keys, titles=("key", *self.runs), caption=caption)
        if self.notes:
            shown += table_html([(note,) for note in self.notes])
        return f"<div>{shown}</div>"


def compare(*runs: Run | str | Path, names: Sequence[str] | None = None) -> Comparison:
    """Compare runs with the first of them.

    Parameters
    ----------
    runs
        At least two runs, or folders of runs.
    names
        Names of the runs; default the names of their folders, or of their scenes.

    Raises
    ------
    InputError
        If there are fewer than two runs, a folder holds no run, or the names are not distinct.
    """
    held = [each if isinstance(each, Run) else Run.load(each) for each in runs]
    called = _names(held) if names is None else [*names]
    if len(called) != len(held) or len(set(called)) != len(called):
        raise InputError(
            "names", f"be {len(held)} different names, one for each run", called, "change the names"
        )
    return Comparison(dict(zip(called, held, strict=True)))


def entries_of(scene: Scene) -> dict[str, object]:
    """Return the entries of a scene by dotted key, with defaults.

    Name and description are left out.
    """
    entries = dict(_flat(tomllib.loads(scene.to_toml())))
    return {key: value for key, value in entries.items() if key not in ("name", "description")}


def write_rows(path: Path, titles: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as CSV with all digits; None becomes an empty cell."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows([titles, *rows])
    with whole_file(path) as temporary:
        temporary.write_text(text.getvalue(), "utf-8")


def _number(value: float | None) -> str:
    """Return a number of a table as text; empty for None."""
    return "" if value is None else f"{value:.4g}"


def _differences(scenes: list[Scene]) -> dict[str, tuple[object, ...]]:
    entries = [entries_of(scene) for scene in scenes]
    keys = dict.fromkeys(key for each in entries for key in each)
    found = {key: tuple(each.get(key) for each in entries) for key in keys}
    return {key: values for key, values in found.items() if values != values[:1] * len(values)}


def _notes(runs: Mapping[str, Run]) -> Iterator[str]:
    """Yield notes on incomplete runs, and on differences other than the scenes."""
    for name, run in runs.items():
        if run.status != "complete":
            yield f"{name} did not reach its end: it is {run.status}"
        if note := path_note(run.summary):
            yield f"the path of {name} is {note}"
    outside: dict[str, list[object]] = {
        "simulated time, which peaks, means and volumes depend on,": [
            f"{round(float(run.summary.get('simulated_s', 0.0)), 3):.12g} s"
            for run in runs.values()
        ],
        "scene": [run.scene.name for run in runs.values()],
        **{
            words: [run.summary.get(entry) for run in runs.values()]
            for entry, words in OUTSIDE.items()
        },
    }
    for words, values in outside.items():
        if len(set(map(str, values))) > 1:
            yield f"{words} differs: {_each(runs, values)}"
    if len({run.scene.constants.key for run in runs.values()}) > 1:
        yield "the constants of the materials differ: see the key materials of each scene"


def _each(names: Iterable[str], values: Iterable[object]) -> str:
    """Return the value of each run as text."""
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{name} {_short(value)}" for name, value in pairs)


def _names(runs: list[Run]) -> list[str]:
    """Return the names of runs by their folders or scenes; equal names are numbered."""
    plain = [run.scene.name if run.path is None else run.path.resolve().name for run in runs]
    count = Counter(plain)
    return [
        f"{name} {plain[: at + 1].count(name)}" if count[name] > 1 else name
        for at, name in enumerate(plain)
    ]


def _flat(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _short(value: object) -> str:
    text = "-" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 1]}…"
