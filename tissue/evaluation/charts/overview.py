"""The frontiers of all scenes in one picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.charts.frontier import Frontier
from tissue.evaluation.charts.picture import numbered, plain_numbers
from tissue.figures.figure import DPI, figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_overview"]

LOOKS = {"script": ("#0072B2", "o", "by script: model"), "hand": ("#B34700", "s", "by hand: loop")}
"""Colours after Okabe and Ito, the second one darker, so that it can be read as text."""
COLUMNS = 4
WIDE_IN, BESIDE_IN, HIGH_IN, TOP_IN = 2.0, 1.95, 2.45, 0.6
"""Width of a panel, of what lies between two, height of both, and what is above all."""
COLOURS = 64
"""Colours of the picture's file."""
LEAST = 1e-4
"""Error that is drawn for none."""
SPAN_US = (30.0, 1.4e3)
"""Ticks that are shown."""
NAME_PT, ROW_IN = 9.0, 0.185
"""Size of a setting's name, and height of its row."""


def draw_overview(found: Sequence[Sequence[Frontier]], path: Path) -> None:
    """Draw a panel for each scene: its Pareto-optimal settings by script and by hand, and the tick of 1 ms.

    They have numbers, which are named beside their panel.
    """
    from PIL import Image

    columns = min(COLUMNS, len(found))
    rows = -(-len(found) // columns)
    width, height = (WIDE_IN + BESIDE_IN) * columns + 0.55, HIGH_IN * rows + TOP_IN
    chart = figure(width, height)
    panels = chart.subplots(rows, columns, squeeze=False).ravel()
    chart.subplots_adjust(
        left=0.72 / width,
        right=1.0 - (BESIDE_IN - 0.17) / width,
        top=1.0 - TOP_IN / height,
        bottom=0.48 / height,
        wspace=BESIDE_IN / WIDE_IN,
        hspace=0.28,
    )
    for panel in panels[len(found) :]:
        panel.set_axis_off()
    for place, (panel, each) in enumerate(zip(panels, found, strict=False)):
        _draw(panel, each)
        if place % columns == 0:
            panel.set_ylabel("force error / %", fontsize=10)
        if place + columns >= len(found):
            panel.set_xlabel("tick / µs", fontsize=10)
    lines = {str(line.get_label()): line for panel in panels for line in panel.lines}
    named = {label: line for label, line in lines.items() if not label.startswith("_")}
    wide = columns > 2
    chart.legend(
        named.values(), named.keys(), loc="upper center", ncols=len(named) if columns > 1 else 2, frameon=False,
        fontsize=10.5 if wide else 7.5, columnspacing=2.0 if wide else 0.8, handlelength=2.0 if wide else 1.2,
    )  # fmt: skip
    save(chart, path)
    with Image.open(path) as drawn:  # few colours: a third of the bytes
        drawn.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def _draw(axes: "Axes", both: Sequence[Frontier]) -> None:
    """One scene."""
    names = []
    for found in both:
        colour, mark, label = LOOKS["script" if found.scene.device is None else "hand"]
        error = [100.0 * max(point.force_error, LEAST) for point in found.best]
        median = [point.median_us for point in found.best]
        names += [(y, x, point.setting, colour, mark) for x, y, point in zip(median, error, found.best, strict=True)]
        axes.step([*median, 1e3], [*error, error[-1]], where="post", color=colour, linewidth=1.5)
        axes.plot([], [], mark, color=colour, markersize=7.0, label=label)
    axes.axvline(1e3, color="0.2", linestyle="--", linewidth=1.2, label="1 ms, the haptic tick")
    names.sort(reverse=True)
    heights = np.log([y for y, *_ in names])
    low, high = heights.min() - 0.5, max(heights.max(), heights.min() + 1.0) + 0.4
    axes.set(xscale="log", yscale="log", xlim=SPAN_US, ylim=np.exp([low, high]))
    left, row = 1.05, ROW_IN * DPI / axes.bbox.height
    for number, (y, x, name, colour, mark) in enumerate(names, 1):
        numbered(axes, x, y, number, colour, mark)
        place, short = 1.0 - (number - 1) * row, name.replace(" mm, shell ", ", ")  # voxels, elements
        for column, words in ((left, f"{number}"), (left + 0.12, short)):
            axes.text(column, place, words, transform=axes.transAxes, fontsize=NAME_PT, color=colour, va="top")
    axes.set_title(both[0].scene.name, fontsize=11)
    axes.set_xticks([100.0, 1e3], ["100", "1000"])
    axes.xaxis.set_minor_formatter("")
    plain_numbers(axes.yaxis)
    axes.grid(alpha=0.25)
