"""Figures of a sweep over the keys that were swept."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.api.plots import COLOURS
from tissue.api.trace import label_of, unit_of
from tissue.figures.figure import plain, styled

if TYPE_CHECKING:
    from tissue.api.sweep_table import Sweep

__all__ = ["can_be_drawn", "differing", "draw_figures"]

COLUMNS = 3
PANEL_IN = (3.2, 2.4)


def differing(sweep: "Sweep") -> list[str]:
    """Figures that are not the same in all finished runs."""
    return [name for name in sweep.figure_names if len({each.figures.get(name) for each in sweep.finished}) > 1]


def can_be_drawn(sweep: "Sweep") -> bool:
    """Whether there are figures to draw over one key or two."""
    return len(sweep.keys) in (1, 2) and bool(differing(sweep))


@styled
def draw_figures(sweep: "Sweep", names: list[str] | None) -> NDArray[np.object_]:
    """Draw figures over the first key; see `tissue.api.sweep_table.Sweep.plot`."""
    from matplotlib import pyplot

    names = differing(sweep) if names is None else names
    if unknown := [name for name in names if name not in sweep.figure_names]:
        raise InputError(f"figures must be of {', '.join(sweep.figure_names)}, got {unknown[0]}: use some of these")
    if not names or len(sweep.keys) not in (1, 2):
        raise InputError(
            f"plot must have figures that differ and one key or two, got {len(names)} figures and {len(sweep.keys)} "
            "keys: see the table"
        )
    columns = min(len(names), COLUMNS)
    count = -(-len(names) // columns)
    chart, grid = pyplot.subplots(
        count, columns, squeeze=False, figsize=(PANEL_IN[0] * columns, PANEL_IN[1] * count + 0.3), layout="constrained"
    )
    panels = grid.ravel()
    for axes in panels[len(names) :]:
        axes.remove()
    lines = _lines(sweep)
    for axes, name in zip(panels, names, strict=False):
        for number, (label, points) in enumerate(lines.items()):
            there = [(place, figures[name]) for place, figures in points if name in figures]
            axes.plot(
                *zip(*there, strict=True), marker="o", markersize=3.5, color=COLOURS[number % len(COLOURS)], label=label
            )
        axes.set_title(" / ".join(part for part in (label_of(name), unit_of(name)) if part), loc="left", size=9.0)
        axes.set_xlabel(sweep.keys[0], parse_math=False)
    plain(panels[: len(names)])
    for axes in panels[: len(names)]:
        axes.margins(x=0.05)
    if len(sweep.keys) == 2:
        handles, labels = panels[0].get_legend_handles_labels()
        chart.legend(
            handles, labels, loc="outside upper left", frameon=False, ncols=6, title=sweep.keys[1], alignment="left"
        )
    return np.asarray(panels[: len(names)])


def _lines(sweep: "Sweep") -> dict[str, list[tuple[float | str, dict[str, float]]]]:
    """By value of the second key, values of the first, in order if they are numbers, with the figures of their runs."""
    first, *second = sweep.keys
    found: dict[str, list[tuple[float | str, dict[str, float]]]] = {}
    for each in sweep.finished:
        value = each.values[first]
        place = value if isinstance(value, float | int) and not isinstance(value, bool) else str(value)
        found.setdefault(str(each.values[second[0]]) if second else "", []).append((place, each.figures))
    for points in found.values():
        if all(not isinstance(place, str) for place, _ in points):
            points.sort(key=lambda point: float(point[0]))
    return found
