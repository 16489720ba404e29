"""Contract of an atlas page: sweep, verdict, answers of the engine, and panels that show them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from io import BytesIO
from math import sqrt
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = [
    "ENGINE",
    "FAILING",
    "GREEN",
    "GREY",
    "ORANGE",
    "THEORY",
    "Answer",
    "Conduct",
    "Curve",
    "Data",
    "Page",
    "Table",
    "Verdict",
    "boundary",
    "error_of",
    "log_slope",
    "panel",
    "picture",
    "refused",
    "shade",
    "shown",
    "sweep",
]

Table = dict[str, Array]
"""Columns of equal length by name, with the unit in the name."""
Data = dict[str, Table]
"""Tables of a sweep by name."""
# The colours are those of Okabe and Ito (2008), distinct for colour-blind readers.
ORANGE = "#E69F00"
GREEN = "#009E73"
GREY = "0.35"
THEORY = ("-", GREY)
FAILING = ("s", "#D55E00")
ENGINE = ("o", "#0072B2")
"""Format and colour of the curve of theory, of the failing method and of the engine."""
Place = Literal["best", "upper left", "lower right", "center right", ""]
Curve = tuple[str, ArrayLike, tuple[str, str]]
"""Label, values over the sweep or one for all of it, and matplotlib's format and colour."""


class Conduct(Enum):
    """Behaviour of the engine where a method fails. The value is the wording of the page."""

    HOLDS = "holds"
    FALLS_BACK = "falls back"
    REFUSES = "refuses"
    SILENT = "is silently wrong"


TINTS = {Conduct.HOLDS: "#D6ECF8", Conduct.FALLS_BACK: "#FBEBC2", Conduct.REFUSES: "#F3CFBC"}
"""Background of a region by the behaviour of the engine."""


@dataclass(frozen=True)
class Answer:
    """Measured behaviour of the engine for one request.

    Attributes
    ----------
    asked
        Request, in words.
    conduct
        Behaviour of the engine.
    result
        Report of the engine, or figures of its result.
    """

    asked: str
    conduct: Conduct
    result: str


@dataclass(frozen=True)
class Verdict:
    """Result of a sweep.

    Attributes
    ----------
    fails
        True if the questioned method failed in the sweep where theory predicts the failure.
    holds
        True if the method of the engine held in the whole sweep.
    sentence
        Both in words, with the figures of the sweep.
    """

    fails: bool
    holds: bool
    sentence: str


class Page(ABC):
    """One page of the atlas.

    Attributes
    ----------
    name
        Short name. The files of the page begin with it.
    title, question
        Text for the reader.
    source
        Source of the theory, and parameters of the sweep.
    """

    name: str
    title: str
    question: str
    source: str

    @abstractmethod
    def measure(self) -> Data:
        """Run the sweep."""

    @abstractmethod
    def judge(self, data: Data) -> Verdict:
        """Return the verdict, from the data alone."""

    @abstractmethod
    def ask(self) -> list[Answer]:
        """Put requests to the engine and return its answers."""

    @abstractmethod
    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the data into an empty figure."""


def refused(asked: str, call: Callable[[], object]) -> Answer:
    """Make a call that should be refused. The answer is silently wrong if it is accepted."""
    try:
        call()
    except InputError as error:
        return Answer(asked, Conduct.REFUSES, str(error))
    return Answer(asked, Conduct.SILENT, "accepted without a report")


def shown(asked: str, right: bool, result: str, conduct: Conduct = Conduct.HOLDS) -> Answer:
    """Return an answer whose figures the caller has checked.

    The answer is silently wrong if the figures are not right.
    """
    return Answer(asked, conduct if right else Conduct.SILENT, result)


def sweep(name: str, values: Array, run: Callable[[float], Mapping[str, float]]) -> Table:
    """Run a function at every value; return the values with a column for each result."""
    rows = [run(value) for value in values.tolist()]
    return {name: values} | {
        column: np.array([row[column] for row in rows], dtype=float) for column in rows[0]
    }


def boundary(fails: Callable[[float], bool], low: float, high: float, *, steps: int) -> float:
    """Find the value between two positive values above which runs fail.

    The search bisects the logarithm.
    """
    for _ in range(steps):
        middle = sqrt(low * high)
        if fails(middle):
            high = middle
        else:
            low = middle
    return sqrt(low * high)


def log_slope(x: Array, y: Array) -> float:
    """Return the power of x with which y grows."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def error_of(found: Array, expected: Array) -> float:
    """Return the largest error relative to the expected values."""
    return float(np.abs(found / expected - 1.0).max())


def picture(page: Page, data: Data) -> bytes:
    """Return the figure of a page as PNG, drawn without a window."""
    with matplotlib.rc_context({"font.size": 11.0, "legend.fontsize": 9.5, "lines.linewidth": 2.0}):
        chart = Figure(figsize=(10.4, 4.4), dpi=130, layout="constrained")
        page.draw(data, chart)
        image = BytesIO()
        chart.savefig(image, format="png", metadata={"Software": None})
    return image.getvalue()


def shade(axes: Axes, x: Array, low: ArrayLike, high: ArrayLike, conduct: Conduct) -> None:
    """Tint the region between two curves by the behaviour of the engine."""
    label = f"engine {conduct.value}"
    axes.fill_between(x, low, high, color=TINTS[conduct], zorder=0, linewidth=0.0, label=label)


def panel(
    axes: Axes,
    x: Array,
    labels: tuple[str, str],
    curves: Sequence[Curve],
    *,
    conduct: Sequence[tuple[Conduct, float, float]] | None = None,
    log: str = "xy",
    legend: Place = "best",
    **settings: object,
) -> None:
    """Draw curves over a sweep, with axes, grid and legend.

    Parameters
    ----------
    axes
        Axes to draw into. Curves that they already hold are in the legend too.
    x
        Values of the sweep, shape (n,).
    labels
        Labels of both axes with their units.
    curves
        Curves over the sweep.
    conduct
        Behaviour of the engine and its range of x. Default: it holds in the whole sweep.
    log
        Names of the logarithmic axes.
    legend
        Place of the legend. No legend is drawn if empty.
    settings
        Settings of `Axes.set`. The default limits of x are the limits of the sweep.
    """
    axes.set(xscale="log" if "x" in log else "linear", yscale="log" if "y" in log else "linear")
    for behaviour, low, high in [(Conduct.HOLDS, x[0], x[-1])] if conduct is None else conduct:
        label = f"engine {behaviour.value}"
        axes.axvspan(low, high, color=TINTS[behaviour], zorder=0, linewidth=0.0, label=label)
    for name, values, (style, colour) in curves:
        axes.plot(x, np.broadcast_to(np.asarray(values), x.shape), style, color=colour, label=name)
    axes.set(xlabel=labels[0], ylabel=labels[1], **({"xlim": (x.min(), x.max())} | settings))
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        # Minor labels of an axis over several decades overlap.
        if axis.get_scale() == "log" and abs(np.log10(high / low)) > 1.0:
            axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)
    axes.set_axisbelow(False)
    if legend:
        axes.legend(loc=legend, framealpha=0.9)
