"""Plots of traces, of several runs and of sweeps."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.objects.trace import Trace, label_of, unit_of
from tissue.scene.named_parts import nearest
from tissue.show.figures.figure import COMPONENTS, MAGNITUDE, plain, styled
from tissue.show.figures.force_depth import first_descent
from tissue.show.figures.force_time import event_footnotes, mark_events
from tissue.simulation.bone_surface import facing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from tissue.objects.sweep_table import Sweep
    from tissue.simulation.trace import Table

__all__ = [
    "FORCE_AND_TORQUE",
    "can_be_drawn",
    "chosen_panels",
    "differing",
    "draw_figures",
    "overlay",
    "plot_columns",
]

FORCE_AND_TORQUE = tuple(
    f"model_{name}"
    for name in (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_Nm" for c in "xyz"))
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
    -------
    The panels, shape (panels,), one for each unit.
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
        if [label_of(name)[-2:] for name in names] == [" x", " y", " z"]:
            size = np.linalg.norm([trace[name] for name in names], axis=0)
            axes.fill_between(
                trace["time_s"], size, color=MAGNITUDE, linewidth=0.0, label="magnitude"
            )
        for name, colour in zip(names, COLOURS * len(names), strict=False):
            axes.plot(trace["time_s"], trace[name], color=colour, label=label_of(name))
    finish(panels, wanted, title)
    mark_events(list(panels), events)
    if ax is None and events:
        lines = "\n".join(event_footnotes(events))
        panels[0].figure.supxlabel(lines, x=0.02, ha="left", size=8.5, parse_math=False)
    return panels


def chosen_panels(trace: Trace, columns: Iterable[str] | None) -> dict[str, list[str]]:
    """Return columns by their unit, by default force and torque.

    Raises
    ------
    InputError
        If there is no such column, or it has no numbers.
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
        found.setdefault(unit_of(name), []).append(name)
    if not found:
        raise InputError(
            "columns", "name at least one", "none", "leave it out for force and torque"
        )
    return found


def new_panels(count: int) -> "NDArray[np.object_]":
    """Return stacked panels in a figure of pyplot, which a notebook shows."""
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


def finish(panels: "NDArray[np.object_]", wanted: dict[str, list[str]], title: str) -> None:
    """Add labels, title and legends."""
    for axes, (unit, names) in zip(panels, wanted.items(), strict=True):
        words = [label_of(name).split() for name in names]
        shared = [first for first, *others in zip(*words, strict=False) if set(others) <= {first}]
        label = " ".join(shared) if len(names) > 1 else label_of(names[0])
        axes.set_ylabel(" / ".join(part for part in (label, unit) if part))
        axes.legend(frameon=False, loc="best", handlelength=1.4, ncols=2)
    panels[0].set_title(title, loc="left", size=10.5, parse_math=False)
    panels[-1].set_xlabel("time / s")
    plain(panels)


MOST_NAMED = 12
"""Largest number of curves that a legend names."""
LONG = 28
"""Number of letters of a name above which a line of the legend holds only two names."""


@styled
def overlay(traces: "Mapping[str, Table]", *, over: str = "time") -> NDArray[np.object_]:
    """Draw the size of force and torque of all traces, and the difference of their forces.

    The difference is between the first trace's force and another trace's force at the same
    position.

    Parameters
    ----------
    traces
        Traces by name.
    over
        ``time``, or ``depth`` from the first contact in the first descent.

    Returns
    -------
    Three panels.
    """
    if over not in ("time", "depth"):
        raise InputError("over", "be time or depth", over, "use one of these")
    panels = new_panels(3)
    first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
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
        legend = panels[0].figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside upper left",
            frameon=False,
            ncols=columns,
        )
        for text in legend.get_texts():
            text.set_parse_math(False)
    plain(panels)
    return panels


def _place(trace: "Table", over: str, name: str) -> tuple[slice, NDArray[np.float64]]:
    """Return the rows to draw, and their time [s] or depth [mm]."""
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


def _at(
    places: NDArray[np.float64], known: NDArray[np.float64], vectors: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate vectors between known positions, shape (places, 3)."""
    return np.column_stack([np.interp(places, known, vectors[:, c]) for c in range(3)])


def _colour(number: int, count: int) -> object:
    """Return a colour: distinct for a few curves, along a scale for many."""
    if count <= len(COLOURS):
        return COLOURS[number]
    from matplotlib import colormaps

    return colormaps["viridis"](number / (count - 1))


COLUMNS = 3
SWEEP_PANEL_IN = (3.2, 2.4)


def differing(sweep: "Sweep") -> list[str]:
    """Return the figures that differ between finished runs."""
    return [
        name
        for name in sweep.figure_names
        if len({each.figures.get(name) for each in sweep.finished}) > 1
    ]


def can_be_drawn(sweep: "Sweep") -> bool:
    """Return whether there are figures to draw over one key or two."""
    return len(sweep.keys) in (1, 2) and bool(differing(sweep))


@styled
def draw_figures(sweep: "Sweep", names: list[str] | None) -> NDArray[np.object_]:
    """Draw figures over the first key; see `tissue.objects.sweep_table.Sweep.plot`."""
    from matplotlib import pyplot

    names = differing(sweep) if names is None else names
    if unknown := [name for name in names if name not in sweep.figure_names]:
        raise InputError(
            "figures", f"be of {', '.join(sweep.figure_names)}", unknown[0], "use some of these"
        )
    if not names or len(sweep.keys) not in (1, 2):
        raise InputError(
            "plot",
            "have figures that differ and one key or two",
            f"{len(names)} figures and {len(sweep.keys)} keys",
            "see the table",
        )
    columns = min(len(names), COLUMNS)
    count = -(-len(names) // columns)
    chart, grid = pyplot.subplots(
        count,
        columns,
        squeeze=False,
        figsize=(SWEEP_PANEL_IN[0] * columns, SWEEP_PANEL_IN[1] * count + 0.3),
        layout="constrained",
    )
    panels = grid.ravel()
    for axes in panels[len(names) :]:
        axes.remove()
    lines = _lines(sweep)
    for axes, name in zip(panels, names, strict=False):
        for number, (label, points) in enumerate(lines.items()):
            there = [(place, figures[name]) for place, figures in points if name in figures]
            axes.plot(
                *zip(*there, strict=True),
                marker="o",
                markersize=3.5,
                color=COLOURS[number % len(COLOURS)],
                label=label,
            )
        axes.set_title(
            " / ".join(part for part in (label_of(name), unit_of(name)) if part),
            loc="left",
            size=9.0,
        )
        axes.set_xlabel(sweep.keys[0], parse_math=False)
    plain(panels[: len(names)])
    for axes in panels[: len(names)]:
        axes.margins(x=0.05)
    if len(sweep.keys) == 2:
        handles, labels = panels[0].get_legend_handles_labels()
        chart.legend(
            handles,
            labels,
            loc="outside upper left",
            frameon=False,
            ncols=6,
            title=sweep.keys[1],
            alignment="left",
        )
    return np.asarray(panels[: len(names)])


def _lines(sweep: "Sweep") -> dict[str, list[tuple[float | str, dict[str, float]]]]:
    """Return sorted values of the first key with figures, by value of the second key."""
    first, *second = sweep.keys
    found: dict[str, list[tuple[float | str, dict[str, float]]]] = {}
    for each in sweep.finished:
        value = each.values[first]
        place = (
            value if isinstance(value, float | int) and not isinstance(value, bool) else str(value)
        )
        found.setdefault(str(each.values[second[0]]) if second else "", []).append(
            (place, each.figures)
        )
    for points in found.values():
        if all(not isinstance(place, str) for place, _ in points):
            points.sort(key=lambda point: float(point[0]))
    return found
