"""Speed against accuracy as a picture: every setting a point, the frontier named, the tick of 1 ms a line."""

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.charts.frontier import Frontier
from tissue.evaluation.charts.measure import Measured
from tissue.figures.figure import figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

__all__ = ["apart", "draw_frontiers", "plain_numbers"]

FAMILIES = {
    "voxels": ("#0072B2", "o", "voxels"),
    "shell": ("#56B4E9", "s", "cutter's elements"),
    "stress": ("#CC79A7", "D", "with stress"),
    "elements": ("#009E73", "^", "elements"),
    "path": ("#E69F00", "v", "compliance"),
    "cores": ("0.45", "P", "one core"),
    "loop": ("#D55E00", "X", "renderer, predictor, model rate"),
    "model": ("0.2", "o", "the model"),
    "law": ("#882255", "*", "elastic law"),
}
LEAST = 1e-6
"""Error that is drawn for none."""
HIGH_IN = 4.4
NAME_POINTS = 11.0
"""Height of a name [pt]."""


def draw_frontiers(found: list[Frontier], path: Path) -> None:
    """Draw a panel for each: median tick with its 99th percentile against force error.

    Shaded is what the reference itself leaves open, lines across are errors that no setting goes below: of the linear
    law, dashed, and of float32, dotted.
    """
    chart = figure(5.6 * len(found), HIGH_IN)
    panels = chart.subplots(1, len(found), squeeze=False)[0]
    chart.subplots_adjust(left=0.14 / len(found), right=0.985, top=0.92, bottom=0.13, wspace=0.24)
    for panel, each in zip(panels, found, strict=True):
        _draw(panel, each)
    save(chart, path)


def _draw(axes: "Axes", found: Frontier) -> None:
    """One scene."""
    points, device = found.points, found.scene.device
    shown = [100.0 * max(point.force_error, LEAST) for point in points]
    known = [100.0 * found.gap] if found.gap > 0.0 else []
    bounds = [row for row in found.bounds if not isnan(row.force_error)]
    law = [100.0 * max(row.force_error, LEAST) for row in bounds if row.family == "law"]
    known += [100.0 * point.error_50_ms for point in points if point.error_50_ms > 0.0]
    low, high = 0.5 * min(shown + known + law), 2.2 * max(*shown, *law, 1e-3)
    labelled = set()
    for point, error in zip(points, shown, strict=True):
        colour, mark, label = FAMILIES[point.family]
        axes.plot([point.median_us, point.p99_us], [error, error], color=colour, linewidth=0.8, alpha=0.5)
        new = label if point.family not in labelled else None
        labelled.add(point.family)
        axes.plot(point.median_us, error, mark, color=colour, markersize=6.5, label=new)
        if point.error_50_ms > 0.0:
            over = 100.0 * max(point.error_50_ms, LEAST)
            axes.plot([point.median_us] * 2, [error, over], color=colour, linewidth=0.8, alpha=0.5)
            axes.plot(point.median_us, over, mark, color=colour, markersize=4.0, markerfacecolor="white")
    best = found.best
    line = [100.0 * max(point.force_error, LEAST) for point in best]
    axes.plot([], [], "o", color="0.4", markersize=4.0, markerfacecolor="white", label="the same over 50 ms")
    axes.step([p.median_us for p in best], line, where="post", color="0.15", linewidth=1.4, label="frontier")
    height = axes.get_position().height * HIGH_IN * 72.0
    places = np.log(np.array(line) / low)[::-1] / np.log(high / low) + 6.0 / height
    names = zip(best[::-1], line[::-1], places, apart(places, NAME_POINTS / height), strict=True)
    for point, error, place, moved in names:
        up = 6.0 + height * (moved - place)
        axes.annotate(point.setting, (point.median_us, error), xytext=(5, up), textcoords="offset points", fontsize=8.5)
    if found.gap > 0.0:
        axes.axhspan(low, 100.0 * found.gap, color="0.9", zorder=0, label="reference not known better")
    for row in bounds:
        _draw_bound(axes, row, low)
    axes.axvline(1e3, color="#D55E00", linestyle="--", linewidth=1.3, label="1 ms")
    axes.set(
        xscale="log",
        yscale="log",
        ylim=(low, high),
        xlabel="tick in contact / µs: median, line to its 99th percentile",
        ylabel="force error over ticks / %, to the reference",
        title=f"{found.scene.name}, " + ("by script" if device == "none" else f"by hand on {device}"),
    )
    plain_numbers(axes.yaxis)
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="best", fontsize=8)


def _draw_bound(axes: "Axes", row: Measured, low: float) -> None:
    """What is no setting: a line across where it has no tick, else a point; the picture ends at ``low`` [%]."""
    colour, mark, label = FAMILIES["law"]
    error = 100.0 * max(row.force_error, LEAST)
    if row.family == "rounding":
        label_text = f"float32 rounding, {error:.1g} %" + (", below the picture" if error < low else "")
        axes.axhline(max(error, low), color="0.35", linestyle=":", linewidth=1.6, label=label_text)
    elif isnan(row.median_us):
        axes.axhline(error, color=colour, linestyle="--", linewidth=1.3)
        label_text = f"linear law: {error:.2g} % off neo-Hookean on this motion;\nbelow it the law is what is wrong"
        axes.text(
            0.985, 0.96 * error, label_text, transform=axes.get_yaxis_transform(), fontsize=8, color=colour, ha="right",
            va="top", linespacing=1.15,
        )  # fmt: skip
    else:
        axes.plot([row.median_us, row.p99_us], [error, error], color=colour, linewidth=0.8, alpha=0.5)
        axes.plot(row.median_us, error, mark, color=colour, markersize=10, label=label)
        axes.annotate(
            f"{row.setting},\n{error:.2g} % off in coarser cells",
            (row.median_us, error),
            xytext=(6, 9),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
            color=colour,
        )


def plain_numbers(axis: "Axis") -> None:
    """Numbers instead of powers of ten on a logarithmic axis."""
    from matplotlib.ticker import LogLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def apart(places: np.ndarray, row: float) -> np.ndarray:
    """Rising places of names, shares of a panel's height, a row or more apart and within the panel."""
    found = places.copy()
    for index in range(1, len(found)):
        found[index] = max(found[index], found[index - 1] + row)
    top = 1.0 - 0.5 * row
    for index in reversed(range(len(found))):
        found[index] = min(found[index], top - (len(found) - 1 - index) * row)
    return found
