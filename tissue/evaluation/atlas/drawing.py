"""How pages are drawn: figures without a window, panels of curves, colours of the engine's conduct."""

from collections.abc import Sequence
from io import BytesIO
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from tissue.evaluation.atlas.page import Conduct, Data, Page

__all__ = ["BLUE", "GREEN", "GREY", "ORANGE", "PINK", "RED", "TINTS", "Curve", "divided", "panel", "picture"]

BLUE, ORANGE, GREEN, RED, PINK, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "0.35"
"""Okabe and Ito (2008), distinct for colour-blind readers."""
TINTS = {Conduct.HOLDS: "#D6ECF8", Conduct.FALLS_BACK: "#FBEBC2", Conduct.REFUSES: "#F3CFBC"}
"""Background of a region by what the engine does there."""
DPI = 130
Place = Literal["best", "upper left", "center left", "lower left", "center right", "lower center", "lower right", ""]
Curve = tuple[str, ArrayLike, str, str]
"""Label, values over the sweep or one for all of it, format as matplotlib's `plot` takes it, and colour."""


def picture(page: Page, data: Data) -> bytes:
    """A page's figure as PNG, drawn without a window."""
    with matplotlib.rc_context(
        {
            "font.size": 11.0,
            "axes.titlesize": 11.5,
            "axes.linewidth": 0.8,
            "legend.fontsize": 9.5,
            "lines.linewidth": 2.0,
            "lines.markersize": 6.0,
        }
    ):
        chart = Figure(figsize=(10.4, 4.4), dpi=DPI, layout="constrained")
        page.draw(data, chart)
        kept = BytesIO()
        chart.savefig(kept, format="png", metadata={"Software": None})
    return kept.getvalue()


def divided(axes: Axes, x: ArrayLike, boundary: ArrayLike, low: float, high: float) -> None:
    """Colour what lies below a boundary as held and what lies above it as refused."""
    axes.fill_between(x, low, boundary, color=TINTS[Conduct.HOLDS], zorder=0, linewidth=0.0, label="engine holds")
    axes.fill_between(x, boundary, high, color=TINTS[Conduct.REFUSES], zorder=0, linewidth=0.0, label="engine refuses")


def panel(
    axes: Axes,
    x: Array,
    x_label: str,
    y_label: str,
    curves: Sequence[Curve],
    *,
    log: str = "xy",
    conduct: Sequence[tuple[Conduct, float, float]] | None = None,
    legend: Place = "best",
    **settings: object,
) -> None:
    """Draw curves over a sweep, with axes, grid and legend.

    Parameters
    ----------
    axes
        Where; what they already hold is in the legend too.
    x, x_label, y_label
        The sweep, shape (n,), and names of the axes with their units.
    curves
        Over the sweep.
    log
        Logarithmic axes.
    conduct
        What the engine does, from where to where along x; it holds all along it where this is left out.
    legend
        Where it goes; none if empty.
    settings
        Of matplotlib's `Axes.set`; the limits of x are those of the sweep where they are left out.
    """
    axes.set(xscale="log" if "x" in log else "linear", yscale="log" if "y" in log else "linear")
    for what, low, high in [(Conduct.HOLDS, x[0], x[-1])] if conduct is None else conduct:
        known = axes.get_legend_handles_labels()[1]
        label = f"engine {what.value}"
        axes.axvspan(low, high, color=TINTS[what], zorder=0, linewidth=0.0, label=None if label in known else label)
    for name, values, style, colour in curves:
        axes.plot(x, np.broadcast_to(np.asarray(values), x.shape), style, color=colour, label=name)
    axes.set(xlabel=x_label, ylabel=y_label, **({"xlim": (x.min(), x.max())} | settings))
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log" and abs(np.log10(high / low)) > 1.0:
            axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3, which="major")
    axes.set_axisbelow(False)
    if legend:
        axes.legend(loc=legend, framealpha=0.9)
