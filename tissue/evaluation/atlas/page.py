"""Base class for the pages of the stability atlas, and functions that write the atlas.

A page varies a parameter, judges the measured results, and draws the results.
"""

import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from html import escape
from importlib.metadata import version
from io import BytesIO
from math import sqrt
from pathlib import Path
from time import perf_counter
from typing import Literal, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file, write_columns, write_text
from tissue.system.html import html_page, html_picture
from tissue.system.owned_folder import OwnedFolder

Table = dict[str, Array]
"""Table: columns of equal length, keyed by name. The name of a column ends with its unit."""
Data = dict[str, Table]
"""Results of an atlas page: one table for each parameter sweep, keyed by name."""
# The colours are those of Okabe and Ito (2008), distinct for colour-blind readers.
ORANGE = "#E69F00"
GREEN = "#009E73"
GREY = "0.35"
THEORY = ("-", GREY)
FAILING = ("s", "#D55E00")
ENGINE = ("o", "#0072B2")
"""Matplotlib format and colour of curves for the method that the simulation uses.

`THEORY` is the style of theoretical curves, and `FAILING` the style of curves for a failing method.
"""
Place = Literal["best", "upper left", "lower right", "center right", ""]
Curve = tuple[str, ArrayLike, tuple[str, str]]
"""Label, values, and matplotlib format and colour of a curve.

A curve has one value for each point of the parameter sweep, or is a constant.
"""


class Conduct(Enum):
    """Behaviour of the simulation in a range of a parameter sweep, and its label in the chart."""

    HOLDS = "holds"
    FALLS_BACK = "falls back"
    REFUSES = "refuses"


TINTS = {Conduct.HOLDS: "#D6ECF8", Conduct.FALLS_BACK: "#FBEBC2", Conduct.REFUSES: "#F3CFBC"}
"""Background colour of a chart region for each behaviour of the simulation."""


class Verdict(NamedTuple):
    """Judgement of the results of a parameter sweep."""

    fails: bool | np.bool_
    """True if the criticised method failed at the parameter values for which theory predicts it."""
    holds: bool | np.bool_
    """True if the method that the simulation uses worked as intended at all parameter values."""
    sentence: str
    """Both results in words, with measured numbers."""


class Page(ABC):
    """One page of the atlas.

    Attributes
    ----------
    name
        Short name; the names of the page's files begin with it.
    title, question
        Title of the page, and question that the page answers.
    source
        Text that gives the source of the theory and the values of the fixed parameters.
    """

    name: str
    title: str
    question: str
    source: str

    @abstractmethod
    def measure(self) -> Data:
        """Vary the parameter of the page; return the measured results."""

    @abstractmethod
    def judge(self, data: Data) -> Verdict:
        """Judge the results of `measure`."""

    @abstractmethod
    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the results of `measure` into an empty figure."""


def sweep(name: str, values: Array, run: Callable[[float], Mapping[str, float]]) -> Table:
    """Run a function at every value; return a table of the values and of the function's results."""
    rows = [run(value) for value in values.tolist()]
    return {name: values} | {
        column: np.array([row[column] for row in rows], dtype=float) for column in rows[0]
    }


def boundary(fails: Callable[[float], bool], low: float, high: float, *, steps: int) -> float:
    """Find the threshold between `low` and `high` above which `fails` returns true.

    `low` and `high` must be positive. The search bisects the logarithm of the value.
    """
    for _ in range(steps):
        middle = sqrt(low * high)
        if fails(middle):
            high = middle
        else:
            low = middle
    return sqrt(low * high)


def log_slope(x: Array, y: Array) -> float:
    """Return the exponent p of y ~ x^p, fitted to the logarithms of x and y."""
    return np.polyfit(np.log(x), np.log(y), 1)[0]


def error_of(found: Array, expected: Array) -> float:
    """Return the largest relative error of values against expected values."""
    return np.abs(found / expected - 1.0).max()


def picture(page: Page, data: Data) -> bytes:
    """Draw the figure of a page without opening a window, and return its PNG file."""
    # 11 points become 14 pixels in the page, nearly as large as its own letters
    with matplotlib.rc_context({"font.size": 11.0, "legend.fontsize": 9.5, "lines.linewidth": 2.0}):
        # inches and dots per inch: 1352 pixels, as wide as the page
        chart = Figure(figsize=(10.4, 4.4), dpi=130, layout="constrained")
        page.draw(data, chart)
        image = BytesIO()
        chart.savefig(image, format="png", metadata={"Software": None})
    return image.getvalue()


def shade(axes: Axes, x: Array, low: ArrayLike, high: ArrayLike, conduct: Conduct) -> None:
    """Fill the region between two curves with the colour of the given simulation behaviour."""
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
    """Draw curves against a parameter, with axes, grid and legend.

    Parameters
    ----------
    axes
        Axes to draw into. The legend also lists curves that these axes already contain.
    x
        Values of the parameter, shape (n,).
    labels
        Labels of both axes with their units.
    curves
        Curves to draw, see `Curve`.
    conduct
        Behaviours of the simulation, each with the lowest and highest x at which it occurs.
        Default: `Conduct.HOLDS` for all x.
    log
        Axes with a logarithmic scale: "x", "y", "xy", or "" for none.
    legend
        Place of the legend. If it is empty, no legend is drawn.
    settings
        Properties for `Axes.set`. By default, the x axis ranges from the smallest to the largest
        value of x.
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


INDEX = "index.html"


@dataclass(frozen=True)
class Entry:
    """Page of the atlas with its results.

    Attributes
    ----------
    page, verdict
        The page, and the verdict on its results.
    picture
        Figure as PNG.
    files
        Names of the written files.
    took_s
        Duration of the measurement [s].
    """

    page: Page
    verdict: Verdict
    picture: bytes
    files: Sequence[str]
    took_s: float

    @property
    def shown(self) -> bool:
        """True if the method criticised on the page failed and the simulation's method worked."""
        return bool(self.verdict.fails and self.verdict.holds)


def chosen_pages(pages: Sequence[Page], only: Sequence[str]) -> list[Page]:
    """Return the pages whose names are in `only`, or all pages if `only` is empty.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    names = [page.name for page in pages]
    if unknown := [name for name in only if name not in names]:
        raise InputError("only", f"be one of {', '.join(names)}", unknown[0], "choose one of these")
    return [page for page in pages if not only or page.name in only]


def write_atlas(
    folder: Path,
    pages: Sequence[Page],
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> list[Entry]:
    """Run atlas pages; write ``index.html``, and a picture and tables (CSV) of each page.

    Raises
    ------
    InputError
        If `folder` is a file, or contains an atlas and `overwrite` is false.
    """
    names = [INDEX, *(f"{page.name}{end}" for page in pages for end in (".png", "_*.csv"))]
    entries = []
    with OwnedFolder(folder, "atlas", names, overwrite=overwrite):
        for number, page in enumerate(pages):
            progress(page.title, number / len(pages))
            entries.append(_written(page, folder))
        write_text(folder / INDEX, _document(entries))
    return entries


def _written(page: Page, folder: Path) -> Entry:
    """Run a page, and write its picture and its data into a folder."""
    started = perf_counter()
    data = page.measure()
    verdict = page.judge(data)
    drawn = picture(page, data)
    with whole_file(folder / f"{page.name}.png") as temporary:
        temporary.write_bytes(drawn)
    files = [f"{page.name}.png"]
    for table, columns in data.items():
        files.append(f"{page.name}_{table}.csv")
        write_columns(folder / files[-1], columns)
    return Entry(page, verdict, drawn, files, perf_counter() - started)


def _document(entries: Sequence[Entry]) -> str:
    """Return the whole atlas as HTML."""
    good = sum(entry.shown for entry in entries)
    rows = "".join(
        f'<tr><td><a href="#{escape(each.page.name)}">{escape(each.page.title)}</a></td><td '
        f'class="what">{"shown" if each.shown else "open: not as it should be"}</td></tr>'
        for each in entries
    )
    facts = {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{platform.machine()}, {platform.system()}",
        "Python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "warp-lang")},
    }
    made = escape("; ".join(f"{name} {value}" for name, value in facts.items()))
    return html_page(
        "Stability atlas",
        "<p>Each page takes a method past its region of failure. Points are measured, lines "
        "are theory, and the background shows the behaviour of the engine. Verdicts are computed "
        f"from the runs of this atlas.</p>\n<p>{good} of {len(entries)} pages show their boundary, "
        f'with the engine holding, falling back or refusing.</p>\n<p class="soft">{made}</p>\n'
        f"<table><tr><th>page</th><th>boundary</th></tr>{rows}</table>\n"
        + "\n".join(map(_section, entries)),
    )


def _section(entry: Entry) -> str:
    """Return one page as HTML."""
    page = entry.page
    files = ", ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in entry.files)
    return (
        "<section "
        f'id="{escape(page.name)}"><h2>{escape(page.title)}</h2>\n<p>{escape(page.question)}</p>\n'
        f"{html_picture(page.title, entry.picture)}"
        f'<p class="verdict{"" if entry.shown else " open"}">{escape(entry.verdict.sentence)}</p>\n'
        f'<p class="soft">{escape(page.source)}. Data: {files}; {entry.took_s:.1f} s.</p></section>'
    )
