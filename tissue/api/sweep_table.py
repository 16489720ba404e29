"""What came of a sweep: a table, the runs beside each other, and each figure over what was swept."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from tissue.api.comparison import Comparison
from tissue.api.html import figures_of, table_html
from tissue.api.run import Run, open_run
from tissue.api.tables import write_table
from tissue.api.trace import needed
from tissue.evaluation.same_task import path_note
from tissue.simulation.run_summary import read_summary

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from numpy.typing import NDArray

__all__ = ["Sweep", "SweptRun"]

FILES = ("sweep.csv", "sweep.png", "compare.png")
"""Names of the files of a sweep, without its runs."""
FIRST_FIGURES = ("peak_force_N", "mean_force_N", "removed_mm3", "tick_median_us")
"""Figures of a table to read; all of them are in the file."""


@dataclass(frozen=True)
class SweptRun:
    """One run of a sweep.

    Attributes
    ----------
    name
        Name of its folder.
    values
        Values of the swept keys.
    path
        Its folder.
    problem
        Why it did not come to its end; empty where it did.
    """

    name: str
    values: dict[str, object]
    path: Path
    problem: str

    @cached_property
    def figures(self) -> dict[str, float]:
        """Its figures, by names with units; none of a run that has a problem."""
        return {} if self.problem else figures_of(read_summary(self.path))

    @cached_property
    def note(self) -> str:
        """Why it did not finish its path; empty where it did or has a problem."""
        return "" if self.problem else path_note(read_summary(self.path))

    def open(self) -> Run:
        """The run, read back."""
        return open_run(self.path)


class Sweep:
    """A scene at all combinations of some values.

    Attributes
    ----------
    keys
        Keys that were swept.
    runs
        All runs, those with a problem included.
    """

    def __init__(self, keys: list[str], runs: list[SweptRun]) -> None:
        self.keys, self.runs = keys, runs

    @property
    def finished(self) -> list[SweptRun]:
        """Runs that came to their end."""
        return [each for each in self.runs if not each.problem]

    @property
    def failures(self) -> dict[str, str]:
        """What went wrong, by run."""
        return {each.name: each.problem for each in self.runs if each.problem}

    @property
    def notes(self) -> dict[str, str]:
        """Why runs did not finish their paths, by run."""
        return {each.name: f"the path is {each.note}" for each in self.runs if each.note}

    @property
    def figure_names(self) -> list[str]:
        """Figures that the runs have, the unit in each name."""
        return list(dict.fromkeys(name for each in self.runs for name in each.figures))

    def rows(self) -> tuple[list[str], list[list[object]]]:
        """Titles and rows: the values, the figures, the problem, the folder and the note of each run."""
        names = self.figure_names
        rows = [
            [
                *(each.values[key] for key in self.keys),
                *(each.figures.get(name) for name in names),
                each.problem,
                each.name,
                each.note,
            ]
            for each in self.runs
        ]
        return [*self.keys, *names, "problem", "run", "note"], rows

    def to_pandas(self) -> "pandas.DataFrame":
        """The table of `rows`.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        titles, rows = self.rows()
        return needed("pandas", extra="pandas").DataFrame(rows, columns=titles)

    def compare(self) -> Comparison:
        """The finished runs beside each other.

        Raises
        ------
        InputError
            If there are fewer than two.
        """
        return Comparison({each.name: each.open() for each in self.finished})

    def plot(self, figures: list[str] | None = None) -> "NDArray[np.object_]":
        """Draw figures over the first swept key, a line for each value of the second.

        Parameters
        ----------
        figures
            Some of `figure_names`; without it those that differ among the runs.

        Returns
        -------
        The panels, shape (figures,).

        Raises
        ------
        InputError
            If there is nothing to draw, or not one or two keys were swept.
        """
        from tissue.api.plots import draw_figures

        return draw_figures(self, figures)

    def write(self, out: Path) -> list[Path]:
        """Write ``sweep.csv``, and where there is more than one finished run ``compare.png`` and ``sweep.png``."""
        from matplotlib import pyplot

        from tissue.api.plots import can_be_drawn
        from tissue.figures.figure import save

        write_table(out / "sweep.csv", *self.rows())
        written = [out / "sweep.csv"]
        pictures = {"compare.png": lambda: self.compare().plot()} if len(self.finished) > 1 else {}
        if can_be_drawn(self):
            pictures["sweep.png"] = self.plot
        for name, draw in pictures.items():
            panels = draw()
            save(panels[0].figure, out / name)
            pyplot.close(panels[0].figure)
            written.append(out / name)
        return written

    def texts(self) -> tuple[list[str], list[list[str]]]:
        """Titles and rows of a table to read: the values, and the figures that one looks at first."""
        names = [name for name in FIRST_FIGURES if name in self.figure_names]
        rows = [
            [*(str(each.values[key]) for key in self.keys), *(_number(each.figures.get(name)) for name in names)]
            for each in self.runs
        ]
        return [*(key.rpartition(".")[2] for key in self.keys), *names], rows

    def __repr__(self) -> str:
        return f"<sweep of {' and '.join(self.keys)}: {len(self.finished)} of {len(self.runs)} runs finished>"

    def _repr_html_(self) -> str:
        titles, rows = self.texts()
        failures = table_html(self.failures.items(), titles=("run", "problem")) if self.failures else ""
        failures += table_html(self.notes.items(), titles=("run", "note")) if self.notes else ""
        return f"<div>{table_html(rows, titles=titles, caption=repr(self).strip('<>'))}{failures}</div>"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
