"""Events and spells of a run, marked in charts over time; what flickers is joined in the drawing, not in the data."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["EVENT_IN", "FLICKER_S", "event_lines", "joined_events", "mark_events", "spells"]

MOST_EVENTS = 6
EVENT_IN = 0.17
"""Height of a line that names an event [inch]."""
FLICKER_S = 0.02
"""Shorter spells are drawn as part of the one before, and an event that comes again within it once [s]: a contact that
begins touches and lets go a few times within a few ticks of 1 ms, and bands of that width are stripes."""


def spells(names: NDArray[np.generic], *, shortest: int = 1) -> list[tuple[int, int, str]]:
    """Runs of equal entries: first index, index behind the last, entry.

    One of fewer entries than `shortest` belongs to the one before it, the first to the one after it.
    """
    if not len(names):
        return []
    starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
    found: list[tuple[int, int, str]] = []
    for first, behind in zip(starts.tolist(), [*starts[1:].tolist(), len(names)], strict=True):
        name = str(names[first])
        if found and (behind - first < shortest or found[-1][2] == name):
            found[-1] = (found[-1][0], behind, found[-1][2])
        elif found and len(found) == 1 and found[0][1] - found[0][0] < shortest:
            found[0] = (0, behind, name)
        else:
            found.append((first, behind, name))
    return found


def joined_events(events: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Events without those that repeat one of the same words, whatever its numbers, within `FLICKER_S`."""
    last: dict[str, float] = {}
    found = []
    for time, what in events:
        words = "".join(each for each in what if not each.isdigit())
        if time - last.get(words, -np.inf) > FLICKER_S:
            found.append((time, what))
        last[words] = time
    return found


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
            size=8.0,
            bbox=box,
            zorder=4,
        )
