"""Observers of a run, called at every tick.

They are called between ticks and must not change the result of the run.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue.simulation.builders.parts import Parts

__all__ = ["Observers", "OnTick", "RunObserver", "TickRow"]

Array = NDArray[np.float64]


class RunObserver:
    """Base class of observers; each method does nothing until it is overridden."""

    timing_columns: tuple[str, ...] = ()
    """Columns that the observer adds to the timing table; it fills the last entries of a row."""

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Prepare for a run of `parts` with the columns of its trace."""

    def before_tick(self, index: int) -> None:
        """Wait until a tick may begin."""

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Read a tick's rows of trace and timing; return whether the run continues."""
        return True

    def on_event(self, time_s: float, what: str) -> None:
        """Handle an event in the tick in which the tissue reports it: time [s] and a sentence."""

    def on_end(self) -> list[tuple[float, str]]:
        """Release resources, also after an error, and return the observer's events.

        An event is a time [s] and a sentence.
        """
        return []


class Observers(RunObserver):
    """Several observers combined into one, called in order.

    `on_begin` calls them in reverse order: the first observer of a live run takes over Ctrl-C after
    all other observers have begun.
    """

    def __init__(self, *observers: RunObserver) -> None:
        self._all = observers
        self.timing_columns = tuple(name for each in observers for name in each.timing_columns)

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Prepare all observers, the last one first."""
        for each in reversed(self._all):
            each.on_begin(parts, columns)

    def before_tick(self, index: int) -> None:
        """Wait for all observers."""
        for each in self._all:
            each.before_tick(index)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Pass the tick to all observers; return whether all of them let the run continue."""
        goes_on = True
        for each in self._all:
            goes_on = each.on_tick(index, row, times) and goes_on
        return goes_on

    def on_event(self, time_s: float, what: str) -> None:
        """Pass an event to all observers."""
        for each in self._all:
            each.on_event(time_s, what)

    def on_end(self) -> list[tuple[float, str]]:
        """End all observers, also if one of them fails."""
        return _ended(self._all)


def _ended(observers: Sequence[RunObserver]) -> list[tuple[float, str]]:
    if not observers:
        return []
    events: list[tuple[float, str]] = []
    try:
        events = observers[0].on_end()
    finally:
        events += _ended(observers[1:])
    return events


class TickRow(Mapping[str, float]):
    """Row of the trace for one tick, by its columns, such as ``row["model_force_z_N"]``.

    It is the same object in every tick and shows the present tick. ``dict(row)`` keeps its values.
    """

    def __init__(self, columns: tuple[str, ...]) -> None:
        self._places = {name: place for place, name in enumerate(columns)}
        self.values_of_tick: Array = np.zeros(len(columns))

    def __getitem__(self, name: str) -> float:
        return float(self.values_of_tick[self._places[name]])

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class OnTick(RunObserver):
    """Observer that calls a function with the number and row of every tick.

    The run ends when the function returns False.
    """

    def __init__(self, function: Callable[[int, TickRow], Any]) -> None:
        self._function = function
        self._row = TickRow(())

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Store the names of the columns."""
        self._row = TickRow(columns)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Call the function."""
        self._row.values_of_tick = row
        answer = self._function(index, self._row)
        return not (isinstance(answer, bool | np.bool_) and not answer)
