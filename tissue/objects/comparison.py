"""Comparison of several runs: scenes, summary values, plots and traces."""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from meshes.base.errors import InputError, counted, enumerated
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import unknown_name
from meshes.base.whole_file import write_text
from tissue.evaluation.assessment import path_note
from tissue.evaluation.same_task import is_event_of, scene_differences, uncommon_parts
from tissue.objects.html import figures_of, figures_of_trace, table_html
from tissue.objects.run import Run
from tissue.objects.trace import needed
from tissue.scene.load import full_key, names_file
from tissue.scene.tool import Tool
from tissue.simulation.run_folder import PICTURE_FORMATS
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import FORMATS, NO_LAYER, check_format, write_columns
from tissue.system.owned_folder import OwnedFolder, require_folder

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from numpy.typing import NDArray

    from tissue.objects.overlay import Over

PLOTTED = (
    *(f"compare.{kind}" for kind in PICTURE_FORMATS),
    *(f"traces.{kind}" for kind in FORMATS),
)
"""Names of the files of the plot and of the table of traces, for each format."""
FILES = ("compare.csv", *PLOTTED)
KIND = "comparison"
"""Kind of output, as written to the file that marks the output folder."""
LONGEST_VALUE = 60
"""Largest number of characters of a scene key's value in the printed lines."""
LONGEST_LABEL = 40
"""Largest number of characters of a legend entry; longer ones are replaced by the run's name."""
DESCRIBING = ("name", "description")
"""Scene keys that have no effect on a run."""
BUILT_IN_IF_EMPTY = ("materials", "device.coupling.predictor_file")
"""Scene keys that name a file; if the value is empty, a built-in file is used."""
OUTSIDE = {"tissue": "version of tissue", "compute": "compute device", "machine": "machine"}
"""Entries of a run's summary, outside the scene, that can change results or tick times."""
Legend = Literal["values", "names", "both"]
"""Text for each run in a legend: values that differ between the runs, name of the run, or both."""


class Comparison:
    """Comparison of runs; all runs are compared with the first run.

    Parameters
    ----------
    runs
        At least two runs, keyed by name.
    legend
        Text in the legend: ``values`` shows the values that differ between the runs, ``names``
        shows the names of the runs, and ``both`` shows both.

    Attributes
    ----------
    runs
        The runs, keyed by name.
    figures
        Figures (numbers that summarise a run) of each run: peak and mean force, removed volume and
        so on, with the unit in each name.
    scene_differences
        For each scene key that differs between runs, the values of all runs; None for a missing
        value.
    notes
        Sentences on facts that limit the comparison, such as a run that ended early.
    """

    def __init__(self, runs: Mapping[str, Run], *, legend: Legend = "values") -> None:
        if len(runs) < 2:
            raise InputError(
                "compare",
                "be given at least two runs",
                counted(len(runs), "run"),
                "name another run",
            )
        self.runs = dict(runs)
        self.figures = {name: _figures(run) for name, run in runs.items()}
        differences = scene_differences(*(run.scene for run in runs.values()))
        self.scene_differences = {
            key: values for key, values in differences.items() if key not in DESCRIBING
        }
        self.notes = list(_notes(self.runs, self.figures))
        if left_out := self._leave_out_events():
            self.notes.append(
                f"the number of events leaves out events of {enumerated(left_out)}, which not all "
                "runs compute"
            )
        self._legend = legend

    def rows(self) -> tuple[list[str], list[tuple[str, list[float | None]]]]:
        """Return the table of summary values: column titles, and the name and numbers of each row.

        Each row is for one summary value, and begins with its value in the first run. For each
        other run it also has three numbers: the value, the difference from the first run, and this
        difference divided by the first run's value.
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
        """Return column titles and rows of a readable table of the summary values that differ.

        For each run but the first, a cell also contains the relative difference from the first run.
        """
        _, rows = self.rows()
        found = []
        for figure, (base, *others) in rows:
            cells = [_number(base)]
            for value, share in zip(others[::3], others[2::3], strict=True):
                cells.append(_number(value) + (f" ({100.0 * share:+.3g} %)" if share else ""))
            if len(set(cells)) > 1:
                found.append([_words(figure), *cells])
        return ["figure", *self.runs], found

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of `rows` as a DataFrame, with one row per summary value.

        `scene_differences` is in ``attrs["scene_differences"]`` of the DataFrame.

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

    def plot(self, over: "Over | None" = None) -> "NDArray[np.object_]":
        """Draw thrust, lateral force and torque of all runs, with 90 % uncertainty bands.

        The legend shows the values that differ between the runs. For two runs, an additional panel
        shows the difference of their forces.

        Parameters
        ----------
        over
            ``time``, or ``depth``: the depth of the tip below the point of first contact, for a
            needle along its axis. If `over` is ``depth``, only ticks in which the tip is deeper
            than ever before are drawn. The default is ``depth`` if, in every run, the depth exceeds
            half of the length of the tip's path in contact. A needle that is withdrawn is drawn
            over time.

        Returns
        -------
        Matplotlib axes, one for each panel, shape (panels,).

        Raises
        ------
        InputError
            If a run never touches the tissue, so that its depth is undefined.
        """
        from tissue.objects.overlay import Curve, overlay

        curves = [
            Curve(
                label,
                run.trace,
                run.band() if "band" in run.summary else None,
                is_path_given=run.scene.device is None and run.scene.motion.kind != "thrust",
            )
            for label, run in zip(self._labels(), self.runs.values(), strict=True)
        ]
        cuts = all(isinstance(run.scene.tool, Tool) for run in self.runs.values())
        return overlay(curves, over=over, about_axis=cuts)

    def _leave_out_events(self) -> list[str]:
        """Subtract the events of parts that not all runs compute, and return these parts."""
        uncommon = uncommon_parts(run.scene for run in self.runs.values())
        left_out = set[str]()
        for name, run in self.runs.items():
            # a run that ended early has no number of events
            if "events" not in self.figures[name]:
                continue
            for event in run.summary["events"]:
                parts = [part for part in uncommon if is_event_of(event["what"], [part])]
                left_out.update(parts)
                if parts:
                    self.figures[name]["events"] -= 1
        return sorted(left_out)

    def _labels(self) -> list[str]:
        """Return one text for each run, for the legend of the plot.

        A text contains the values of the scene keys that differ. If two of these texts are equal or
        one is too long, the names of the runs are returned instead.
        """
        if self._legend == "names":
            return list(self.runs)
        keys = {
            key: shortened(key, values)
            for key, values in self.scene_differences.items()
            if not any(isinstance(value, list) for value in values)
        }
        labels = []
        for at in range(len(self.runs)):
            stated = [_stated(key, keys[key][at], self.scene_differences) for key in keys]
            labels.append(", ".join(stated))
        if self._legend == "both" and keys:
            labels = [f"{name}: {label}" for name, label in zip(self.runs, labels, strict=True)]
        are_usable = len(set(labels)) == len(labels) and max(map(len, labels)) <= LONGEST_LABEL
        return labels if are_usable else list(self.runs)

    def traces(self) -> "dict[str, NDArray[Any]]":
        """Return the traces of all runs as one table, one row per tick.

        The first columns are the name of the run and the values of the scene keys that differ. In
        the names of these columns, ``_`` replaces each dot. A column that a run does not have
        contains NaN in the run's rows, or ``none`` if the column contains layer names.
        """
        import numpy as np

        counts = [len(run.trace.rows) for run in self.runs.values()]
        found = {"run": np.repeat(list(self.runs), counts)}
        for key, values in self.scene_differences.items():
            are_numbers = all(isinstance(value, int | float) for value in values)
            cells = np.array(values if are_numbers else [_short(value) for value in values])
            found[key.replace(".", "_")] = np.repeat(cells, counts)
        for name in dict.fromkeys(name for run in self.runs.values() for name in run.trace):
            gap = NO_LAYER if name == "layer" else np.nan
            parts = [
                run.trace[name] if name in run.trace else np.full(count, gap)
                for run, count in zip(self.runs.values(), counts, strict=True)
            ]
            found[name] = np.concatenate(parts)
        return found

    def save(
        self,
        out: str | Path,
        *,
        over: "Over | None" = None,
        formats: Iterable[str] = (),
        overwrite: bool = False,
    ) -> list[Path]:
        """Write ``compare.csv``, the plot and the traces of all runs into a folder.

        The method returns the paths of the written files.

        Parameters
        ----------
        out
            Folder to write.
        over
            As for `plot`.
        formats
            Formats of the plot: png, svg or pdf; default png. Formats of the traces: parquet, npz,
            mat or h5; without one of these, traces are not written.
        overwrite
            True to replace a comparison that the folder already contains.

        Raises
        ------
        InputError
            If the folder holds another comparison or a format is unknown.
        """
        out = Path(out)
        split_formats(formats)
        require_folder(out, KIND, FILES, overwrite=overwrite)
        titles, rows = self.rows()
        with OwnedFolder(out, KIND, FILES, overwrite=overwrite):
            lines = [[figure, *values] for figure, values in rows]
            write_rows(out / FILES[0], ["figure", *titles], lines)
            written = self.write_plotted(out, over=over, formats=formats)
        return [out / FILES[0], *written]

    def write_plotted(
        self, out: Path, *, over: "Over | None" = None, formats: Iterable[str] = ()
    ) -> list[Path]:
        """Write the plot and the traces of all runs into a folder; see `save`."""
        from matplotlib import pyplot

        from tissue.show.figures.figure import save

        pictures, tables = split_formats(formats)
        panels = self.plot(over)
        written = [out / f"compare.{kind}" for kind in pictures]
        for path in written:
            save(panels[0].figure, path)
        pyplot.close(panels[0].figure)
        columns = self.traces() if tables else {}
        for kind in tables:
            written.append(out / f"traces.{kind}")
            write_columns(columns, written[-1])
        return written

    def lines(self) -> list[str]:
        """Return text lines: differing scene keys, summary values equal in all runs, and notes."""
        found = [
            f"{key}: {_each(self.runs, [_named(key, value) for value in values])}"
            for key, values in self.scene_differences.items()
        ]
        differing = {row[0] for row in self.texts()[1]}
        figures = [_words(figure) for figure, _ in self.rows()[1]]
        same = [figure for figure in figures if figure not in differing]
        equal = [f"the same in all runs: {', '.join(same)}"] if same else []
        return [*(found or ["the scenes are the same"]), *equal, *self.notes]

    def __repr__(self) -> str:
        return f"<comparison of {', '.join(self.runs)}: {len(self.scene_differences)} keys differ>"

    def _repr_html_(self) -> str:
        titles, rows = self.texts()
        keys = [
            [key, *(_short(_named(key, value)) for value in values)]
            for key, values in self.scene_differences.items()
        ]
        shown = table_html(rows, titles=titles)
        if keys:
            caption = "keys of the scenes that differ"
            shown += table_html(keys, titles=("key", *self.runs), caption=caption)
        if self.notes:
            shown += table_html([(note,) for note in self.notes])
        return f"<div>{shown}</div>"


def _words(figure: str) -> str:
    """Return the name of a summary value in readable tables."""
    # Runs with equally many events may have different events.
    return "number of events" if figure == "events" else figure


@suggests_arguments
def compare(*runs: Run | str | Path, names: Sequence[str] | None = None) -> Comparison:
    """Compare runs with the first run.

    Parameters
    ----------
    runs
        At least two runs, or folders of runs.
    names
        Names of the runs. The default is the name of each run's folder, or the name of the scene if
        the run has no folder. If the runs are in different parent folders, the default names
        include the parent folder.

    Raises
    ------
    InputError
        If there are fewer than two runs, a folder holds no run, or the names are not distinct.
    """
    held = [each if isinstance(each, Run) else Run.load(each) for each in runs]
    called = _names(held) if names is None else [*names]
    if len(called) != len(held) or len(set(called)) != len(called):
        raise InputError(
            "names",
            f"be {len(held)} different names, one for each run",
            called,
            "give each run its own name",
        )
    legend: Legend = "values"
    if names is not None:
        legend = "names"
    elif all(run.path is not None for run in held):
        # the names of the folders were chosen by the user, too
        legend = "both"
    return Comparison(dict(zip(called, held, strict=True)), legend=legend)


def split_formats(formats: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split file formats into the formats of plots and the formats of tables.

    Raises
    ------
    InputError
        If a format is unknown, or the package that writes the format is not installed.
    """
    formats = tuple(dict.fromkeys(formats))
    known = (*PICTURE_FORMATS, *FORMATS)
    for kind in formats:
        if kind not in known:
            raise unknown_name("format", known, kind)
        if kind in FORMATS:
            check_format(kind)
    pictures = tuple(kind for kind in formats if kind in PICTURE_FORMATS)
    return pictures or PICTURE_FORMATS[:1], tuple(kind for kind in formats if kind in FORMATS)


def shortened(key: str, values: Sequence[Any]) -> Sequence[Any]:
    """Shorten file paths in the values of a key to file names, if these remain distinct."""
    if not names_file(full_key(key)):
        return values
    names = [None if value is None else Path(str(value)).name for value in values]
    return names if len(set(names)) == len(set(values)) else values


def write_rows(path: Path, titles: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as CSV with all digits; None becomes an empty cell."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows([titles, *rows])
    write_text(path, text.getvalue())


def _number(value: float | None) -> str:
    """Return a number as text for a table cell; empty for None."""
    return "" if value is None else f"{value:.4g}"


def _figures(run: Run) -> dict[str, float]:
    """Return the summary values of a run; if the run ended early, compute them from its trace."""
    if run.status == "complete":
        return figures_of(run.summary)
    try:
        trace = run.trace
    except InputError:
        # A damaged trace is refused when the run is loaded, so here the file is missing.
        return {}
    return figures_of_trace(trace)


def _notes(runs: Mapping[str, Run], figures: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Yield notes on incomplete runs, and on differences between runs outside their scenes."""
    for name, run in runs.items():
        if run.status != "complete":
            origin = "Its time and loads are from its trace"
            if not figures[name]:
                origin = "Its trace.csv is missing or holds no tick, so it has no figures"
            yield f"{name} did not reach its end: it is {run.status}. {origin}"
        if note := path_note(run.summary):
            yield f"the path of {name} is {note}"
    outside: dict[str, list[object]] = {
        "simulated time, which peaks, means and volumes depend on,": [
            f"{round(each.get('simulated_s', 0.0), 3):.12g} s" for each in figures.values()
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
    """Return one text with the name and the value of each run."""
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{name} {_short(value)}" for name, value in pairs)


def _stated(key: str, value: object, keys: Iterable[str]) -> str:
    """Return a key and its value in words, such as ``thrust 20 N``."""
    table, _, last = key.rpartition(".")
    is_unique = sum(other.rpartition(".")[2] == last for other in keys) == 1
    # A kind is named by its table, such as device touch.
    short = table if last == "kind" else last
    words, unit = field_label(short if is_unique else key.replace(".", "_"))
    if value is None:
        return f"no {words}"
    shown = f"{value:g}" if isinstance(value, float) else _short(_named(key, value))
    return " ".join(filter(None, (words, shown, unit)))


def _names(runs: list[Run]) -> list[str]:
    """Return names for runs, taken from their folders or scenes; equal names are numbered.

    If all runs are in different folders, a name consists of the parent folder and the folder of the
    run. If two such names are equal, folders above them are added. Parts that all runs share are
    left out.
    """
    plain = [run.scene.name if run.path is None else run.path.resolve().name for run in runs]
    folders = [run.path.resolve().parts for run in runs if run.path is not None]
    if len(folders) == len(runs) == len(set(folders)):
        # Attempts of different trainees may have different names.
        size = 2
        while len({parts[-size:] for parts in folders}) < len(runs):
            size += 1
        ends = [parts[-size:] for parts in folders]
        differing = [at for at in range(-size, 0) if len({end[at] for end in ends}) > 1]
        return ["/".join(end[at] for at in differing) for end in ends]
    count = Counter(plain)
    return [
        f"{name} {plain[: at + 1].count(name)}" if count[name] > 1 else name
        for at, name in enumerate(plain)
    ]


def _named(key: str, value: object) -> object:
    """Return the value of a scene key for display; an empty file name becomes ``built-in``."""
    return "built-in" if value == "" and key in BUILT_IN_IF_EMPTY else value


def _short(value: object) -> str:
    text = "-" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 1]}…"
