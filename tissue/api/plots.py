"""Columns of a trace over time, in panels by their unit."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError
from tissue.api.trace import Trace, label_of, unit_of
from tissue.figures.events import event_lines, mark_events
from tissue.figures.figure import plain, styled
from tissue.figures.style import COMPONENTS, MAGNITUDE
from tissue.scene.named_parts import nearest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = ["FORCE_AND_TORQUE", "chosen_panels", "plot_columns"]

FORCE_AND_TORQUE = tuple(
    f"model_{name}" for name in (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_Nm" for c in "xyz"))
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
            f"ax must take columns of one unit, got {', '.join(wanted)}: give columns of one of them, or leave ax out"
        )
    panels = new_panels(len(wanted)) if ax is None else np.array([ax])
    for axes, names in zip(panels, wanted.values(), strict=True):
        if [label_of(name)[-2:] for name in names] == [" x", " y", " z"]:
            size = np.linalg.norm([trace[name] for name in names], axis=0)
            axes.fill_between(trace["time_s"], size, color=MAGNITUDE, linewidth=0.0, label="magnitude")
        for name, colour in zip(names, COLOURS * len(names), strict=False):
            axes.plot(trace["time_s"], trace[name], color=colour, label=label_of(name))
    finish(panels, wanted, title)
    mark_events(list(panels), events)
    if ax is None and events:
        lines = "\n".join(event_lines(events))
        panels[0].figure.supxlabel(lines, x=0.02, ha="left", size=8.5, parse_math=False)
    return panels


def chosen_panels(trace: Trace, columns: Iterable[str] | None) -> dict[str, list[str]]:
    """Columns by their unit, by default force and torque.

    Raises
    ------
    InputError
        If there is no such column, or it has no numbers.
    """
    asked: Sequence[str] = (
        FORCE_AND_TORQUE if columns is None else [columns] if isinstance(columns, str) else [*columns]
    )
    found: dict[str, list[str]] = {}
    for name in asked:
        if name not in trace or name == "layer":
            known = [each for each in trace if each != "layer"]
            raise InputError(
                f"columns must name columns of numbers of the trace, got {name}{nearest(name, known)}: use some of "
                f"{', '.join(known)}"
            )
        found.setdefault(unit_of(name), []).append(name)
    if not found:
        raise InputError("columns must name at least one, got none: leave it out for force and torque")
    return found


def new_panels(count: int) -> "NDArray[np.object_]":
    """Panels over each other in a figure of pyplot, which a notebook shows."""
    from matplotlib import pyplot

    _, panels = pyplot.subplots(
        count, 1, sharex=True, squeeze=False, figsize=(8.0, 0.8 + PANEL_IN * count), layout="constrained"
    )
    return np.asarray(panels[:, 0])


def finish(panels: "NDArray[np.object_]", wanted: dict[str, list[str]], title: str) -> None:
    """Labels, title and legends."""
    for axes, (unit, names) in zip(panels, wanted.items(), strict=True):
        words = [label_of(name).split() for name in names]
        shared = [first for first, *others in zip(*words, strict=False) if set(others) <= {first}]
        label = " ".join(shared) if len(names) > 1 else label_of(names[0])
        axes.set_ylabel(" / ".join(part for part in (label, unit) if part))
        axes.legend(frameon=False, loc="best", handlelength=1.4, ncols=2)
    panels[0].set_title(title, loc="left", size=10.5, parse_math=False)
    panels[-1].set_xlabel("time / s")
    plain(panels)
