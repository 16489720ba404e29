"""Speed against accuracy as a picture: every setting a point, the frontier named, the tick of 1 ms a line."""

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

from tissue.evaluation.charts.frontier import Frontier
from tissue.evaluation.charts.measure import Measured
from tissue.figures.figure import figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

__all__ = ["draw_frontiers", "numbered", "plain_numbers"]

FAMILIES = {
    "voxels": ("#0072B2", "o", "voxels"),
    "shell": ("#56B4E9", "s", "cutter's elements"),
    "stress": ("#CC79A7", "D", "with stress"),
    "elements": ("#009E73", "p", "elements"),
    "path": ("#E69F00", "H", "compliance"),
    "cores": ("0.45", "h", "one core"),
    "loop": ("#D55E00", "o", "renderer, predictor, model rate"),
    "model": ("0.2", "o", "the model"),
    "law": ("#882255", "*", "elastic law"),
}
LEAST = 1e-6
"""Error that is drawn for none."""
PANEL_IN, BESIDE_IN, HIGH_IN = 4.6, 2.6, 4.6
"""Width of a panel, of what is written beside it, and height of the picture."""
LEFT_IN, GAP_IN = 0.72, 0.12
NAME_PT = 8.5
MANY = 2e3
"""Ratio of an axis's ends from which on its numbers are powers of ten."""
ROW_IN = 0.165
"""Height of a written row."""


def draw_frontiers(found: list[Frontier], path: Path) -> None:
    """Draw a panel for each: median tick with its 99th percentile against force error.

    Settings of the frontier have numbers, which are named beside the panel. Shaded is what the reference itself leaves
    open, lines across are errors that no setting goes below: of the linear law, dashed, and of float32, dotted.
    """
    step = LEFT_IN + PANEL_IN + BESIDE_IN
    wide = step * len(found)
    chart = figure(wide, HIGH_IN)
    for index, each in enumerate(found):
        left = (index * step + LEFT_IN) / wide
        panel = chart.add_axes((left, 0.13, PANEL_IN / wide, 0.79))
        _draw(panel, each)
        _write_beside(panel, each)
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
    for number, (point, error) in enumerate(zip(best, line, strict=True), 1):
        colour, mark, _ = FAMILIES[point.family]
        numbered(axes, point.median_us, error, number, colour, mark)
    if found.gap > 0.0:
        axes.axhspan(low, 100.0 * found.gap, color="0.9", zorder=0, label="reference not known better")
    for row in bounds:
        _draw_bound(axes, row, low)
    axes.axvline(1e3, color="#D55E00", linestyle="--", linewidth=1.3, label="1 ms")
    axes.set_ylim(low, high)  # first, since a single error alone spans no scale
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="tick in contact / µs: median, line to its 99th percentile",
        ylabel="force error over ticks / %, to the reference",
        title=f"{found.scene.name}, " + ("by script" if device is None else f"by hand on {device.kind}"),
    )
    plain_numbers(axes.yaxis)
    plain_numbers(axes.xaxis)
    axes.grid(alpha=0.3, which="both")


def _write_beside(axes: "Axes", found: Frontier) -> None:
    """Names of the frontier's settings by number, and the legend, to the right of a panel."""
    left, row = 1.0 + GAP_IN / PANEL_IN, ROW_IN / (0.79 * HIGH_IN)
    axes.text(left, 1.0, "frontier", transform=axes.transAxes, fontsize=NAME_PT, weight="bold", va="top")
    for number, point in enumerate(found.best, 1):
        colour, place = FAMILIES[point.family][0], 1.0 - number * row
        axes.text(left, place, f"{number}", transform=axes.transAxes, fontsize=NAME_PT, color=colour, va="top")
        axes.text(left + 0.05, place, point.setting, transform=axes.transAxes, fontsize=NAME_PT, va="top")
    axes.legend(
        loc="lower left", bbox_to_anchor=(left, 0.0), borderaxespad=0.0, borderpad=0.0, fontsize=8, frameon=False
    )


def numbered(axes: "Axes", x: float, y: float, number: int, colour: str, mark: str) -> None:
    """Mark a point of a frontier with its number."""
    axes.plot(x, y, mark, color=colour, markersize=11.5, markeredgecolor="white", markeredgewidth=0.7, zorder=4)
    axes.annotate(
        f"{number}", (x, y), xytext=(0.0, -0.3), textcoords="offset points", ha="center", va="center",
        fontsize=7.5, weight="bold", color="white", zorder=5,
    )  # fmt: skip


def _draw_bound(axes: "Axes", row: Measured, low: float) -> None:
    """What is no setting: a line across where it has no tick, else a point; the picture ends at ``low`` [%]."""
    colour, mark, label = FAMILIES["law"]
    error = 100.0 * max(row.force_error, LEAST)
    if row.family == "rounding":
        label_text = f"float32 rounding, {error:.1g} %" + (", below the picture" if error < low else "")
        axes.axhline(max(error, low), color="0.35", linestyle=":", linewidth=1.6, label=label_text)
    elif isnan(row.median_us):
        label_text = f"linear law: {error:.2g} % off neo-Hookean\non this motion; below it the law is\nwhat is wrong"
        axes.axhline(error, color=colour, linestyle="--", linewidth=1.3, label=label_text)
    else:
        axes.plot([row.median_us, row.p99_us], [error, error], color=colour, linewidth=0.8, alpha=0.5)
        label_text = f"{label}: {row.setting},\n{error:.2g} % off in coarser cells"
        axes.plot(row.median_us, error, mark, color=colour, markersize=10, label=label_text)


def plain_numbers(axis: "Axis") -> None:
    """Numbers instead of powers of ten on a logarithmic axis, few of them where it spans much."""
    from matplotlib.ticker import LogLocator

    low, high = axis.get_view_interval()
    wide = high > MANY * low > 0.0
    axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")
