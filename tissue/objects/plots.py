"""Plots of a trace, and of summary values of runs over a swept value."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, enumerated
from meshes.base.hints import nearest
from tissue.objects.trace import Trace
from tissue.show.figures.figure import COMPONENTS, MAGNITUDE, field_words, plain, styled
from tissue.show.figures.force_time import mark_events
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import components

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORCE_AND_TORQUE = components("model_force", "N") + components("model_torque", "Nm")
COLOURS = (*COMPONENTS, "#CC79A7", "#E69F00", "#56B4E9", "0.1")
PANEL_IN = 2.3
BAR: dict[str, Any] = {"linewidth": 5.0, "alpha": 0.3}
"""Matplotlib style of a bar for a 90 % interval."""
Point = tuple[object, Mapping[str, float], Mapping[str, tuple[float, float]]]
"""Swept value of a run, its summary values, and 90 % intervals of some of these values."""


@styled
def plot_columns(
    trace: Trace,
    events: list[tuple[float, str]],
    *,
    title: str,
    columns: Iterable[str] | None = None,
    ax: "Axes | None" = None,
) -> "NDArray[np.object_]":
    """Draw columns of a trace over time, and mark events.

    Returns
    -------
    Matplotlib axes, one for each unit, shape (panels,).
    """
    wanted = chosen_panels(trace, columns)
    if ax is not None and len(wanted) > 1:
        raise InputError(
            "ax",
            "be given for columns of one unit",
            f"columns with the units {enumerated(unit or 'none' for unit in wanted)}",
            "give columns of one unit, or leave ax out",
        )
    panels = new_panels(len(wanted)) if ax is None else np.array([ax])
    for axes, names in zip(panels, wanted.values(), strict=True):
        labels = [field_label(name)[0] for name in names]
        # Only the three components of a vector have a magnitude.
        if [label[-2:] for label in labels] == [" x", " y", " z"]:
            size = np.linalg.norm([trace[name] for name in names], axis=0)
            axes.fill_between(
                trace["time_s"], size, color=MAGNITUDE, linewidth=0.0, label="magnitude"
            )
        for name, label, colour in zip(names, labels, cycle(COLOURS), strict=False):
            axes.plot(trace["time_s"], trace[name], color=colour, label=label)
        axes.set_ylabel(field_words(*names))
        axes.legend(loc="best", ncols=2)
    panels[0].set_title(title, loc="left", size=10.5, parse_math=False)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    mark_events(panels, events, listed=ax is None)
    return panels


def chosen_panels(trace: Trace, columns: Iterable[str] | None) -> dict[str, list[str]]:
    """Return the columns to draw, keyed by unit; the default is force and torque.

    Raises
    ------
    InputError
        If a column does not exist, or does not contain numbers.
    """
    asked: Sequence[str] = FORCE_AND_TORQUE
    if columns is not None:
        asked = [columns] if isinstance(columns, str) else [*columns]
    found: dict[str, list[str]] = {}
    for name in asked:
        if name not in trace or name == "layer":
            known = [each for each in trace if each != "layer"]
            raise InputError(
                "columns",
                "name columns of numbers in the trace",
                f"{name}{nearest(name, known)}",
                f"choose among {', '.join(known)}",
            )
        found.setdefault(field_label(name)[1], []).append(name)
    if not found:
        raise InputError(
            "columns",
            "name at least one column",
            "none",
            "to plot force and torque, leave columns out",
        )
    return found


def new_panels(count: int) -> "NDArray[np.object_]":
    """Return `count` axes, one below the other, in a new figure of pyplot."""
    from matplotlib import pyplot

    _, panels = pyplot.subplots(
        count,
        1,
        sharex=True,
        squeeze=False,
        figsize=(8.0, 0.8 + PANEL_IN * count),
        layout="constrained",
    )
    return np.asarray(panels[:, 0])


@styled
def plot_figures(
    lines: Mapping[str, Sequence[Point]],
    names: Sequence[str],
    *,
    over: str,
    title: str,
) -> NDArray[np.object_]:
    """Draw summary values of runs over a varied value, with one line for each group of runs.

    Parameters
    ----------
    lines
        Points of each line, keyed by the label of the line. A point belongs to one run.
    names
        Names of the summary values to draw, one in each panel.
    over
        Scene key whose values were varied; these values are on the horizontal axis.
    title
        Title of the legend: the scene key whose value differs between the lines. Empty for a single
        line without a legend.

    Returns
    -------
    Matplotlib axes, one for each name, shape (names,).
    """
    from matplotlib import pyplot

    # four panels are two rows of two, so that no row has a single panel
    columns = 2 if len(names) == 4 else min(len(names), 3)
    rows = -(-len(names) // columns)
    # Heights in inches of a panel, and of the legend above all panels.
    size = 3.2 * columns, 2.4 * rows + 0.3
    chart, grid = pyplot.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained")
    panels, empty = np.split(grid.ravel(), [len(names)])
    for axes in empty:
        axes.remove()
    for axes, name in zip(panels, names, strict=True):
        for number, (label, runs) in enumerate(lines.items()):
            points = [(_place_of(value), found[name]) for value, found, _ in runs if name in found]
            colour = COLOURS[number % len(COLOURS)]
            look: dict[str, Any] = {"marker": "o", "markersize": 3.5, "color": colour}
            if any(isinstance(place, str) for place, _ in points):
                look["linestyle"] = ""  # there is nothing between two names
                # long names, such as those of files, would overlap
                axes.tick_params(axis="x", rotation=20.0)
            else:
                points.sort()
            axes.plot(*zip(*points, strict=True), label=label, **look)
            for value, _, intervals in runs:
                if name in intervals:
                    axes.vlines(_place_of(value), *intervals[name], color=colour, **BAR)
        axes.set_title(field_words(name), loc="left")
        axes.set_xlabel(field_words(over.rpartition(".")[2]), parse_math=False)
    plain(panels)
    for axes in panels:
        axes.margins(x=0.05)
        axes.ticklabel_format(axis="y", useOffset=False)
        # From zero: an axis around the points shows a change of 1 % as steeply as one of 100 %.
        low, high = axes.get_ylim()
        if low > 0.0:
            axes.set_ylim(0.0, 1.05 * high)
    texts = [field_words(title.rpartition(".")[2])] if title else []
    if any(intervals for runs in lines.values() for *_, intervals in runs):
        texts.append("bars: 90 %")
    if texts:
        entries = panels[0].get_legend_handles_labels() if title else ([], [])
        text = "; ".join(texts)
        chart.legend(*entries, loc="outside upper left", ncols=6, title=text, alignment="left")
    return np.asarray(panels)


def _place_of(value: Any) -> float | str:
    """Return a swept value as a number, or as text if it is not a number."""
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return value if is_number else str(value)
