"""Forces and torques of several runs in one picture."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.api.plots import COLOURS, new_panels
from tissue.figures.figure import plain, styled
from tissue.figures.force_depth import first_descent
from tissue.simulation.depth_map import facing

if TYPE_CHECKING:
    from tissue.simulation.trace import Table

__all__ = ["overlay"]

MOST_NAMED = 12
"""Curves that a legend names."""
LONG = 28
"""Letters of a name of which only two stand in a line."""


@styled
def overlay(traces: "Mapping[str, Table]", *, over: str = "time") -> NDArray[np.object_]:
    """Draw the size of force and torque of all, and of the first one's force minus each other's at the same place.

    Parameters
    ----------
    traces
        By name.
    over
        ``time``, or ``depth`` from the first contact in the first descent.

    Returns
    -------
    Three panels.
    """
    if over not in ("time", "depth"):
        raise InputError(f"over must be time or depth, got {over}: use one of these")
    panels = new_panels(3)
    first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    for number, (name, trace) in enumerate(traces.items()):
        rows, place = _place(trace, over, name)
        force, torque = trace.vectors("model_force", "N")[rows], trace.vectors("model_torque", "Nm")[rows]
        look = {"color": _colour(number, len(traces)), "label": name, "linewidth": 1.1}
        panels[0].plot(place, np.linalg.norm(force, axis=1), **look)
        panels[1].plot(place, np.linalg.norm(torque, axis=1), **look)
        if first is None:
            first = place, force
        else:
            common = first[0][(first[0] >= place[0]) & (first[0] <= place[-1])]
            apart = _at(common, place, force) - _at(common, *first)
            panels[2].plot(common, np.linalg.norm(apart, axis=1), **look)
    for axes, label in zip(panels, ("force / N", "torque / N m", "force apart from\nthe first one's / N"), strict=True):
        axes.set_ylabel(label)
    panels[-1].set_xlabel("time / s" if over == "time" else "depth of the tool's tip from its first contact / mm")
    if len(traces) <= MOST_NAMED:
        columns = 3 if max(map(len, traces)) < LONG else 2
        legend = panels[0].figure.legend(
            *panels[0].get_legend_handles_labels(), loc="outside upper left", frameon=False, ncols=columns
        )
        for text in legend.get_texts():
            text.set_parse_math(False)
    plain(panels)
    return panels


def _place(trace: "Table", over: str, name: str) -> tuple[slice, NDArray[np.float64]]:
    """Rows to draw, and where they lie: time [s], or depth [mm], which only grows."""
    if over == "time":
        return slice(None), trace["time_s"]
    axis, outward = facing(trace)
    contact = trace["contact_mm2"] > 0.0
    if not contact.any():
        raise InputError(f"runs must touch the tissue to be drawn over depth, got {name} without contact: use time")
    height = outward * trace.vectors("tool", "mm")[:, axis]
    rows = first_descent(height, contact)
    return rows, np.maximum.accumulate(height[contact.argmax()] - height[rows])


def _at(places: NDArray[np.float64], known: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors between known places, shape (places, 3)."""
    return np.column_stack([np.interp(places, known, vectors[:, c]) for c in range(3)])


def _colour(number: int, count: int) -> object:
    """A colour of its own for a few, one along a scale for many."""
    if count <= len(COLOURS):
        return COLOURS[number]
    from matplotlib import colormaps

    return colormaps["viridis"](number / (count - 1))
