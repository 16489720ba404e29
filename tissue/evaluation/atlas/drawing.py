"""How pages are drawn: figures without a window, colours of the engine's conduct, points beside lines."""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tissue.evaluation.atlas.page import Conduct, Data, Page

__all__ = ["BLUE", "GREEN", "GREY", "ORANGE", "PINK", "RED", "TINTS", "divided", "finish", "picture", "region"]

BLUE, ORANGE, GREEN, RED, PINK, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "0.35"
"""Okabe and Ito (2008), distinct for colour-blind readers."""
TINTS = {Conduct.HOLDS: "#D6ECF8", Conduct.FALLS_BACK: "#FBEBC2", Conduct.REFUSES: "#F3CFBC"}
"""Background of a region by what the engine does there."""
DPI = 130
STYLE: dict[Any, Any] = {
    "font.size": 11.0,
    "axes.titlesize": 11.5,
    "axes.linewidth": 0.8,
    "legend.fontsize": 9.5,
    "lines.linewidth": 2.0,
    "lines.markersize": 6.0,
}


def picture(page: Page, data: Data) -> bytes:
    """A page's figure as PNG, drawn without a window."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        chart = Figure(figsize=(10.4, 4.4), dpi=DPI, layout="constrained")
        page.draw(data, chart)
        kept = BytesIO()
        chart.savefig(kept, format="png", metadata={"Software": None})
    return kept.getvalue()


def region(axes: Any, conduct: Conduct, low: float, high: float) -> None:
    """Colour a strip by what the engine does in it; label it once."""
    known = axes.get_legend_handles_labels()[1]
    label = f"engine {conduct.value}"
    axes.axvspan(low, high, color=TINTS[conduct], zorder=0, linewidth=0.0, label=None if label in known else label)


def divided(axes: Any, x: ArrayLike, boundary: ArrayLike, low: float, high: float) -> None:
    """Colour what lies below a boundary as held and what lies above it as refused."""
    axes.fill_between(x, low, boundary, color=TINTS[Conduct.HOLDS], zorder=0, linewidth=0.0, label="engine holds")
    axes.fill_between(x, boundary, high, color=TINTS[Conduct.REFUSES], zorder=0, linewidth=0.0, label="engine refuses")


def finish(axes: Any, x: str, y: str, *, title: str = "", legend: str = "best", **settings: Any) -> None:
    """Name the axes with their units, set limits and scales, draw grid and legend."""
    from matplotlib.ticker import NullFormatter

    axes.set(xlabel=x, ylabel=y, title=title, **settings)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log" and abs(np.log10(high / low)) > 1.0:
            axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3, which="major")
    axes.set_axisbelow(False)
    if legend:
        axes.legend(loc=legend, framealpha=0.9)
