"""Events of a run, marked in charts over time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["EVENT_IN", "event_lines", "mark_events"]

MOST_EVENTS = 6
EVENT_IN = 0.17
"""Height of a line that names an event [inch]."""


def event_lines(events: list[tuple[float, str]]) -> list[str]:
    """A numbered line for each event, and one for those that are too many."""
    lines = [f"{i}   {time:.3f} s: {what}" for i, (time, what) in enumerate(events[:MOST_EVENTS], 1)]
    left = len(events) - MOST_EVENTS
    return [*lines, f"and {left} more"] if left > 0 else lines


def mark_events(panels: "Sequence[Axes]", events: list[tuple[float, str]]) -> None:
    """A line through all panels at every event, its number on top, lower where it would cover the one before."""
    low, high = panels[0].get_xlim()
    place, lowered = -np.inf, 0
    for number, (time, _) in enumerate(events[:MOST_EVENTS], 1):
        for axes in panels:
            axes.axvline(time, color="0.15", linewidth=0.9, linestyle=(0, (4, 2)), zorder=3)
        lowered = (lowered + 1) % 3 if time - place < 0.02 * (high - low) else 0
        place = time
        box = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "0.15", "linewidth": 0.7}
        panels[0].annotate(
            str(number),
            (time, 0.93 - 0.1 * lowered),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="center",
            size=7.5,
            bbox=box,
            zorder=4,
        )
