"""Plots of a trace, of several runs in the same axes, and of figures over a swept value."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.text_tables import nearest
from tissue.objects.trace import Trace
from tissue.show.figures.figure import COMPONENTS, MAGNITUDE, field_words, plain, styled
from tissue.show.figures.force_depth import first_descent
from tissue.show.figures.force_time import mark_events
from tissue.simulation.bone_surface import facing
from tissue.simulation.saved_fields import field_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tissue.simulation.trace import Table

__all__ = ["COLOURS", "overlay", "plot_columns", "plot_figures"]


FORCE_AND_TORQUE = tuple(
    f"model_{name}_{c}_{unit}" for name, unit in (("force", "N"), ("torque", "Nm")) for c in "xyz"
)
COLOURS = (*COMPONENTS, "#CC79A7", "#E69F00", "#56B4E9", "0.1")
PANEL_IN = 2.3


@styled
def plot_columns(
    trace: Trace,
    events: list[tuple[float, str]],
    *,
    title: str,
    columns: Iterable[str] | None = None,
    ax: "Axes | None" = None,
) -> "NDArray[np.object_]":
    """Draw columns over time, by default force and torque on the tool, and mark events.

    Returns
    ------- Axes, shape (panels,), one for each unit.
    """
    wanted = chosen_panels(trace, columns)
    if ax is not None and len(wanted) > 1:
        raise InputError(
            "ax",
            "take columns of one unit",
            ", ".join(wanted),
            "give columns of one of them, or leave ax out",
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
    """Return the columns to draw, grouped by unit; the default is force and torque.

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
                "name columns of numbers of the trace",
                f"{name}{nearest(name, known)}",
                f"use some of {', '.join(known)}",
            )
        found.setdefault(field_label(name)[1], []).append(name)
    if not found:
        raise InputError(
            "columns", "name at least one", "none", "leave it out for force and torque"
        )
    return found


def new_panels(count: int) -> "NDArray[np.object_]":
    """Return stacked axes in a figure of pyplot, which a notebook shows."""
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


MOST_NAMED = 12
"""Largest number of curves in a legend, which then takes four lines above the panels."""
LONG = 28
"""Largest number of letters in a name for which a line of the legend holds more than two names."""


@styled
def overlay(traces: "Mapping[str, Table]", *, over: str = "time") -> NDArray[np.object_]:
    """Draw the magnitudes of force and torque of all traces, and the differences between their
    forces.

    The last panel shows the magnitude of the difference between the force of each other trace and
    the force of the first trace, at the same time or depth.

    Parameters
    ----------
    traces
        Traces, keyed by name.
    over
        ``time``, or ``depth`` below the point of first contact, during the first descent.

    Returns
    ------- Three axes.
    """
    if over not in ("time", "depth"):
        raise InputError("over", "be time or depth", over, "use one of these")
    panels = new_panels(3)
    first: tuple[Array, Array] | None = None
    for number, (name, trace) in enumerate(traces.items()):
        rows, place = _place(trace, over, name)
        force = trace.vectors("model_force", "N")[rows]
        torque = trace.vectors("model_torque", "Nm")[rows]
        look = {"color": _colour(number, len(traces)), "label": name, "linewidth": 1.1}
        panels[0].plot(place, np.linalg.norm(force, axis=1), **look)
        panels[1].plot(place, np.linalg.norm(torque, axis=1), **look)
        if first is None:
            first = place, force
        else:
            # A difference exists only where both traces have values.
            common = first[0][(first[0] >= place[0]) & (first[0] <= place[-1])]
            apart = _at(common, place, force) - _at(common, *first)
            panels[2].plot(common, np.linalg.norm(apart, axis=1), **look)
    for axes, label in zip(
        panels, ("force / N", "torque / N m", "force apart from\nthe first one's / N"), strict=True
    ):
        axes.set_ylabel(label)
    panels[-1].set_xlabel(
        "time / s" if over == "time" else "depth of the tool's tip from its first contact / mm"
    )
    if len(traces) <= MOST_NAMED:
        columns = 3 if max(map(len, traces)) < LONG else 2
        entries = panels[0].get_legend_handles_labels()
        legend = panels[0].figure.legend(*entries, loc="outside upper left", ncols=columns)
        for text in legend.get_texts():
            text.set_parse_math(False)
    plain(panels)
    return panels


def _place(trace: "Table", over: str, name: str) -> tuple[slice, Array]:
    """Return the rows to draw, and the time [s] or depth [mm] of each row."""
    if over == "time":
        return slice(None), trace["time_s"]
    axis, outward = facing(trace)
    contact = trace["contact_mm2"] > 0.0
    if not contact.any():
        raise InputError(
            "runs", "touch the tissue to be drawn over depth", f"{name} without contact", "use time"
        )
    height = outward * trace.vectors("tool", "mm")[:, axis]
    rows = first_descent(height, contact)
    return rows, np.maximum.accumulate(height[contact.argmax()] - height[rows])


def _at(places: Array, known: Array, vectors: Array) -> Array:
    """Interpolate vectors between known positions, shape (places, 3)."""
    return np.column_stack([np.interp(places, known, vectors[:, c]) for c in range(3)])


def _colour(number: int, count: int) -> object:
    """Return the colour of a curve: from a list of distinct colours, or from a scale if there are
    many curves.
    """
    if count <= len(COLOURS):
        return COLOURS[number]
    from matplotlib import colormaps

    return colormaps["viridis"](number / (count - 1))


@styled
def plot_figures(
    lines: Mapping[str, Sequence[tuple[object, Mapping[str, float]]]],
    names: Sequence[str],
    *,
    over: str,
    title: str,
) -> NDArray[np.object_]:
    """Draw figures of runs over a swept value, with a line for each group of runs.

    Parameters
    ----------
    lines
        Value and figures of each run, keyed by the label of the line.
    names
        Names of the figures to draw, one in each panel.
    over
        Name of the swept value.
    title
        Title of the legend; empty for a single line without a legend.

    Returns
    ------- Axes, shape (names,).
    """
    from matplotlib import pyplot

    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    # Heights in inches of a panel, and of the legend above all panels.
    size = 3.2 * columns, 2.4 * rows + 0.3
    chart, grid = pyplot.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained")
    panels, empty = np.split(grid.ravel(), [len(names)])
    for axes in empty:
        axes.remove()
    for axes, name in zip(panels, names, strict=True):
        for number, (label, runs) in enumerate(lines.items()):
            points = [(_place_of(value), found[name]) for value, found in runs if name in found]
            if not any(isinstance(place, str) for place, _ in points):
                points.sort()
            look = {"marker": "o", "markersize": 3.5, "color": COLOURS[number % len(COLOURS)]}
            axes.plot(*zip(*points, strict=True), label=label, **look)
        axes.set_title(field_words(name), loc="left")
        axes.set_xlabel(over, parse_math=False)
    plain(panels)
    for axes in panels:
        axes.margins(x=0.05)
    if title:
        entries = panels[0].get_legend_handles_labels()
        chart.legend(*entries, loc="outside upper left", ncols=6, title=title)
    return np.asarray(panels)


def _place_of(value: Any) -> float | str:
    """Return the position of a swept value on an axis: a number, or a text if the value is not a
    number.
    """
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return value if is_number else str(value)
