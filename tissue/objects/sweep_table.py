"""Table, plots and comparison of the runs of a sweep."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.same_task import path_note
from tissue.objects.comparison import Comparison
from tissue.objects.html import figures_of, table_html
from tissue.objects.run import Run
from tissue.objects.tables import write_table
from tissue.objects.trace import needed
from tissue.scene.scene import Scene
from tissue.simulation.run_folder import read_summary

if TYPE_CHECKING:
    import pandas

__all__ = ["Sweep", "SweptRun"]

FIRST_FIGURES = ("peak_force_N", "mean_force_N", "removed_mm3", "tick_median_us")
"""Figures of the printed table; the file has all figures."""


@dataclass(frozen=True)
class SweptRun:
    """One run of a sweep.

    Attributes
    ----------
    name
        Name of its folder, by the swept keys.
    values
        Values of the swept keys.
    path
        Folder of the run.
    problem
        Error that ended it or makes its scene invalid; empty for a finished run.
    scene
        Scene; None if the values make none.
    """

    name: str
    values: dict[str, object]
    path: Path
    problem: str = ""
    scene: Scene | None = None

    @cached_property
    def figures(self) -> dict[str, float]:
        """Figures of the run by names with units; empty for a run with a problem."""
        return {} if self.problem else figures_of(read_summary(self.path))

    @cached_property
    def note(self) -> str:
        """Reason why the run did not finish its path; else empty.

        It is also empty for a run with a problem.
        """
        return "" if self.problem else path_note(read_summary(self.path))

    def open(self) -> Run:
        """Read the run from its folder."""
        return Run.load(self.path)


class Sweep:
    """Results of a scene at all combinations of some values.

    Attributes
    ----------
    keys
        Keys that were swept.
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
        """Problems by run."""
        return {each.name: each.problem for each in self.runs if each.problem}

    @property
    def notes(self) -> dict[str, str]:
        """Reasons why runs did not finish their paths, by run."""
        return {each.name: f"the path is {each.note}" for each in self.runs if each.note}

    @property
    def figure_names(self) -> list[str]:
        """Names of the figures that the runs have, with units."""
        return list(dict.fromkeys(name for each in self.runs for name in each.figures))

    def rows(self) -> tuple[list[str], list[list[object]]]:
        """Return titles and rows of a table with one row per run.

        A row has the values, the figures, the problem, the folder and the note of the run.
        """
        names = self.figure_names
        rows = []
        for each in self.runs:
            figures = [each.figures.get(name) for name in names]
            rows.append([*each.values.values(), *figures, each.problem, each.name, each.note])
        return [*self.keys, *names, "problem", "run", "note"], rows

    def texts(self) -> tuple[list[str], list[list[str]]]:
        """Return titles and rows of a short table: the values and the first figures."""
        names = [name for name in FIRST_FIGURES if name in self.figure_names]
        rows = []
        for each in self.runs:
            figures = [
                f"{each.figures[name]:.4g}" if name in each.figures else "" for name in names
            ]
            rows.append([*map(str, each.values.values()), *figures])
        return [*(key.rpartition(".")[2] for key in self.keys), *names], rows

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of `rows`; raises `InputError` if pandas is not installed."""
        titles, rows = self.rows()
        return needed("pandas", extra="pandas").DataFrame(rows, columns=titles)

    def compare(self) -> Comparison:
        """Compare the finished runs; raises `InputError` if there are fewer than two."""
        return Comparison({each.name: each.open() for each in self.finished})

    def plot(self, figures: list[str] | None = None) -> NDArray[np.object_]:
        """Plot figures over the first swept key, with a line for each value of the second.

        Parameters
        ----------
        figures
            Some of `figure_names`; default the figures that differ among the runs.

        Returns
        -------
        The panels, shape (figures,).

        Raises
        ------
        InputError
            If there is nothing to plot, or not one or two keys were swept.
        """
        from tissue.objects.plots import draw_figures

        return draw_figures(self, figures)

    def write(self, out: Path) -> None:
        """Write ``sweep.csv``, and with several finished runs ``compare.png`` and ``sweep.png``."""
        from matplotlib import pyplot

        from tissue.objects.plots import can_be_drawn
        from tissue.show.figures.figure import save

        write_table(out / "sweep.csv", *self.rows())
        pictures = {}
        if len(self.finished) > 1:
            pictures["compare.png"] = self.compare().plot()
        if can_be_drawn(self):
            pictures["sweep.png"] = self.plot()
        for name, panels in pictures.items():
            save(panels[0].figure, out / name)
            pyplot.close(panels[0].figure)

    def __repr__(self) -> str:
        return (
            f"<sweep of {' and '.join(self.keys)}: {len(self.finished)} of {len(self.runs)} runs "
            "finished>"
        )

    def _repr_html_(self) -> str:
        titles, rows = self.texts()
        shown = table_html(rows, titles=titles, caption=repr(self).strip("<>"))
        for title, texts in (("problem", self.failures), ("note", self.notes)):
            if texts:
                shown += table_html(texts.items(), titles=("run", title))
        return f"<div>{shown}</div>"
