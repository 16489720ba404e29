"""One section of a report: a table with the paper's figures in it, sentences on both, and a picture."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from meshes.base.arrays import Array
from meshes.base.whole_file import whole_file
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.paper import Figure
from tissue.evaluation.study.tasks import METHODS, TASKS

__all__ = [
    "COLOURS",
    "Section",
    "against",
    "agreement",
    "drawing",
    "image",
    "interval_by_users",
    "legend",
    "methods_of",
    "spread",
    "tasks_of",
]  # fmt: skip

ROUNDED = 0.05
"""Share by which a figure may be off that is published without its spread."""
COLOURS = {
    "penalty": "#999999",
    "energy": "#E69F00",
    "koopman": "#0072B2",
    "koopman-look-ahead": "#56B4E9",
    "koopman-perception": "#009E73",
}
"""Of methods (Okabe and Ito 2008)."""


@dataclass(frozen=True)
class Section:
    """A section.

    Attributes
    ----------
    name
        Short name; its data lie in a CSV file of that name.
    title
        For the reader.
    sentences
        What agrees, what does not, and what the numbers mean, computed from the data.
    header, rows
        The table.
    picture
        PNG, or nothing.
    pictures
        More of them, each with its description.
    """

    name: str
    title: str
    sentences: tuple[str, ...]
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    picture: bytes = b""
    pictures: tuple[tuple[str, bytes], ...] = ()

    def write_csv(self, folder: Path) -> str:
        """Write the table; the name of its file, empty where there is no table."""
        if not self.rows:
            return ""
        with (
            whole_file(folder / f"{self.name}.csv") as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            csv.writer(file, lineterminator="\n").writerows([self.header, *self.rows])
        return f"{self.name}.csv"


def spread(values: Array, digits: int = 2) -> str:
    """Mean and standard deviation in words."""
    return f"{values.mean():.{digits}f} ± {values.std(ddof=1) if len(values) > 1 else 0.0:.{digits}f}"


def agreement(ours: Array, paper: Figure) -> str:
    """Whether two means lie within the standard deviation of their difference, or how far apart they are."""
    our_mean = float(ours.mean())
    reach = float(np.hypot(ours.std(ddof=1) if len(ours) > 1 else 0.0, paper.spread or ROUNDED * paper.mean))
    if abs(our_mean - paper.mean) <= reach:
        return "agrees"
    return f"{our_mean / paper.mean:.2f} of it" if paper.mean else "differs"


def against(ours: Array, paper: Figure | None) -> tuple[str, str]:
    """The paper's figure and how ours agrees with it, both empty where it has none."""
    return (str(paper), agreement(ours, paper)) if paper else ("", "")


def tasks_of(table: TrialTable) -> list[str]:
    """Tasks that have trials, in their order."""
    return [each for each in TASKS if each in table.task]


def methods_of(table: TrialTable) -> list[str]:
    """Methods that have trials, in their order."""
    return [each for each in METHODS if each in table.method]


def interval_by_users(table: TrialTable, metric: str, method: str) -> tuple[float, float, float]:
    """Mean of users' means of a metric, none failed, under a method, and its 95 % interval by t over users."""
    from scipy.stats import ttest_1samp

    kept = table.where(method=method)
    people, person = np.unique(kept.people(), return_inverse=True)
    means = np.bincount(person, kept.values(metric)) / np.bincount(person)
    centre = float(means.mean())
    if len(people) < 2:
        return centre, centre, centre
    low, high = ttest_1samp(means, 0.0).confidence_interval(0.95)
    return centre, float(low), float(high)


def drawing(width: float, height: float, columns: int = 1) -> tuple[Drawing, list[Axes]]:
    """An empty figure [inches] and its axes."""
    figure = Drawing(figsize=(width, height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, columns))
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes.tolist()


def legend(figure: Drawing, axes: Axes) -> None:
    """A legend of some axes above the figure, where it covers nothing."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False, fontsize=9)


def image(figure: Drawing) -> bytes:
    """PNG of a figure."""
    held = io.BytesIO()
    figure.savefig(held, format="png", dpi=120)
    return held.getvalue()
