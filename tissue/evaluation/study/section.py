"""Building blocks of the report of a study: sections, published results, texts and pictures."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from meshes.base.arrays import Array
from meshes.base.whole_file import write_rows
from tissue.evaluation.looks import looks
from tissue.evaluation.statistics.intervals import Interval, signed_interval
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import METHODS, TASKS

SOURCE = (
    "A Koopman-Bayesian Framework for High-Fidelity, Perceptually Optimized Haptic Surgical "
    "Simulation, N = 900 trials (3 tasks x 3 expertise groups x 100)"
)
CHOSEN_AFTER: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "The error of the force is computed at the motor. Earlier studies used the force before "
        "the motor.",
        ("T1", "T2", "T3", "reaming", "drilling"),
    ),
    (
        "Ratios of intensity are computed in windows that lie entirely in contact. A study of 180 "
        "trials also used windows that lie partly in contact.",
        ("T1", "T2", "T3"),
    ),
    (
        "The tool of T3 moves by a tenth of the motion of the hand, and the softer bone has 60 % "
        "of the usual density. In earlier studies, the tool moved as far as the hand, the softer "
        "bone had 90 %, and the sensitivity to force was 0.12.",
        ("T3",),
    ),
    (
        "The needle is pushed by a rising force and stopped by a reaction. A first study reversed "
        "it at a given depth.",
        ("needle",),
    ),
    (
        "A puncture that the person does not notice counts as the longest travel, and a push ends "
        "at a depth of 60 mm. A study of 180 trials left such trials out.",
        ("needle",),
    ),
    (
        "The target of the hand in reaming lies below the bone, so that the tool reams. In a study "
        "of 180 trials, the target was the wanted depth, and the tool hardly cut.",
        ("reaming",),
    ),
)
"""Choices of the study's design that were made after results of earlier studies were known.

Each choice is listed with the tasks that it concerns. No other such choices are known.
"""


@dataclass(frozen=True)
class Figure:
    """Published result: mean and standard deviation.

    The standard deviation is zero if none was published.
    """

    mean: float
    spread: float = 0.0

    def __str__(self) -> str:
        return f"{self.mean:g} (SD {self.spread:g})" if self.spread else f"{self.mean:g}"


PRINTED = ("penalty", "koopman", "koopman-perception")
"""Methods for which the published study has force errors."""
FORCE_ERROR = {
    task: dict(zip(PRINTED, map(Figure, means, spreads), strict=True))
    for task, means, spreads in (
        ("T1", (8.2, 3.5, 2.1), (2.1, 1.0, 0.7)),
        ("T2", (7.1, 3.0, 1.8), (1.8, 0.9, 0.6)),
        ("T3", (9.5, 4.2, 2.8), (2.4, 1.2, 0.8)),
    )
}
"""Published normalised L2 errors of the force [%], by task and method.

In the published study, the three methods are named raw, Koopman-adjusted and perceptual.
"""
POSITION_ERROR_MM = {"T1": Figure(0.71, 0.12), "T2": Figure(0.63, 0.10), "T3": Figure(0.85, 0.15)}
"""Published position errors [mm], by task."""
CASES = {"reaming_rms_N": Figure(2.5), "torque_step_Nm": Figure(0.08)}
"""Published results of the case studies, keyed by metric.

The published error of reaming is an upper bound.
"""

ROUNDED = 0.05
"""Relative tolerance for agreement with a published value without a standard deviation.

The tolerance covers the rounding to two digits.
"""


@dataclass(frozen=True)
class Section:
    """Section of a report.

    Attributes
    ----------
    name
        Short name. The CSV file of the table has this name too.
    title
        Title in the report.
    sentences
        Sentences with the findings, computed from the data.
    table
        Rows of the table; each row maps column names to entries. A row may omit columns.
    picture
        PNG picture. May be empty.
    headline
        Main finding in one sentence, which the first section of the report repeats.
    """

    name: str
    title: str
    sentences: Sequence[str]
    table: Sequence[Mapping[str, str]] = ()
    picture: bytes = b""
    headline: str = ""

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns of the table."""
        return tuple(dict.fromkeys(name for row in self.table for name in row))

    @property
    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Entries of the table by row and column. An omitted entry is an empty text."""
        header = self.header
        return tuple(tuple(row.get(name, "") for name in header) for row in self.table)

    def write_csv(self, folder: Path) -> str:
        """Write the table as CSV; return the name of the file, or an empty text without a table."""
        if not self.table:
            return ""
        write_rows(folder / f"{self.name}.csv", [self.header, *self.rows])
        return f"{self.name}.csv"


def spread(values: Array, digits: int = 2) -> str:
    """Return mean and standard deviation as text.

    The text does not use the sign ±, because the mean minus the standard deviation can be negative
    even if no value is negative.
    """
    return f"{values.mean():.{digits}f} (SD {_deviation(values):.{digits}f})"


def _deviation(values: Array) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0


def _agreement(ours: Array, paper: Figure) -> str:
    """Compare the mean of values with a published mean; return the result as text.

    The text is "agrees" if the means differ by at most the root of the sum of both squared standard
    deviations. Otherwise, it states the ratio of the means.
    """
    reach = np.hypot(_deviation(ours), paper.spread or ROUNDED * paper.mean)
    if abs(ours.mean() - paper.mean) <= reach:
        return "agrees"
    return f"{ours.mean() / paper.mean:.2f} of the paper's"


def against(ours: Array, paper: Figure | None, unit: str) -> dict[str, str]:
    """Return table entries: the published value and its agreement; empty if `paper` is None."""
    if paper is None:
        return {}
    return {f"paper {unit}": str(paper), "against paper": _agreement(ours, paper)}


def published(task: str, figure: Figure | None) -> Figure | None:
    """Return a published value; None if the published task differs from the task of this study."""
    return None if TASKS[task].known_difference else figure


def tasks_of(table: TrialTable) -> list[str]:
    """Return the tasks that have trials, in the order of `TASKS`."""
    return [each for each in TASKS if each in table.task]


def methods_of(table: TrialTable) -> list[str]:
    """Return the methods that have trials, first those in `METHODS`, then all others."""
    others = sorted(set(table.method.tolist()) - set(METHODS))
    return [*(each for each in METHODS if each in table.method), *others]


def parts_of(table: TrialTable) -> dict[tuple[str, str], TrialTable]:
    """Divide a table of trials by task and method."""
    pairs = product(tasks_of(table), methods_of(table))
    return {(task, method): table.where(task=task, method=method) for task, method in pairs}


def interval_by_users(table: TrialTable, metric: str) -> Interval:
    """Return the mean over users of each user's mean of a metric, with a 95 % interval."""
    _, person = np.unique(table.people(), return_inverse=True)
    means = np.bincount(person, table.values(metric)) / np.bincount(person)
    return signed_interval(means)


def drawing(width: float, height: float, columns: int = 1) -> tuple[Drawing, list[Axes]]:
    """Return an empty figure with a row of axes; width and height are in inches."""
    figure = Drawing(figsize=(width, height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, columns))
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes.tolist()


def grouped_points(
    axes: Axes,
    groups: Sequence[str],
    points: Mapping[tuple[int, str], Sequence[float]],
    papers: Mapping[tuple[int, str], Figure] | None = None,
) -> None:
    """Draw one point with an interval for each group and method.

    Published values are drawn as diamonds.

    Parameters
    ----------
    axes
        Axes for the points.
    groups
        Labels of the groups along the x axis.
    points
        Value, and lower and upper end of its interval, keyed by the pair (index of the group,
        method).
    papers
        Published values, keyed by the pair (index of the group, method).
    """
    methods = list(dict.fromkeys(method for _, method in points))
    styles = looks(methods)
    # the points of a group take 0.7 of its unit, so that groups are apart
    width = 0.7 / len(methods)
    middle = 0.5 * (len(methods) - 1)
    for method in methods:
        shift = width * (methods.index(method) - middle)
        mine = {index + shift: point for (index, name), point in points.items() if name == method}
        values, lows, highs = np.array(list(mine.values())).T
        colour, marker = styles[method]
        axes.vlines(list(mine), lows, highs, color=colour, linewidth=2)
        axes.plot(list(mine), values, marker, color=colour, label=method)
    for (index, method), paper in (papers or {}).items():
        # a third of the distance of two points to the right, so that both marks are visible
        place = index + width * (methods.index(method) - middle + 0.33)
        axes.errorbar(place, paper.mean, paper.spread, fmt="D", color="black", markersize=4)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_xlim(-0.5, len(groups) - 0.5)
    axes.grid(axis="y", alpha=0.3)


def legend(figure: Drawing, axes: Axes) -> None:
    """Add the legend of axes above the figure, where it covers no curve."""
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside upper center",
        # the six default methods in one line
        ncols=6,
        frameon=False,
    )


def image(figure: Drawing) -> bytes:
    """Return a figure as PNG."""
    held = io.BytesIO()
    # 1320 pixels for the usual 11 inches: sharp on a page of 62 rem, 992 pixels
    figure.savefig(held, format="png", dpi=120)
    return held.getvalue()
