"""Ticks of a live run at a raised priority, whatever else goes along with them."""

import numpy as np
from numpy.typing import NDArray

from tissue.builders.parts import Parts
from tissue.models.tissue_model import TICK_S
from tissue.simulation.simulate import RunObserver
from tissue.system.tick_priority import TickPriority

__all__ = ["Prioritised"]

FULL = 0.9
"""Share of the time that ticks may take at a raised priority: Linux stops what takes 95 % of a second for the rest."""
LOOK_TICKS = 200
"""Ticks between two looks at what they took."""


class Prioritised:
    """Goes along with the ticks: raises the priority of their thread, and gives it back at the end.

    It is given back earlier where the ticks would leave nothing to others: the system would then stop them for longer
    than it makes them late at ordinary priority.

    Parameters
    ----------
    inner
        The run's other observer.
    priority
        What raises it.

    Attributes
    ----------
    note
        The priority that the ticks ran at, in words.
    """

    def __init__(self, inner: RunObserver, priority: TickPriority | None = None) -> None:
        self.timing_columns = inner.timing_columns
        self.note = ""
        self._inner, self._priority = inner, priority or TickPriority()
        self._busy_us, self._relented = 0.0, list[tuple[float, str]]()

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """The ticks begin."""
        self._inner.on_begin(parts, columns)

    def before_tick(self, index: int) -> None:
        """Raise the priority before the first tick, here, for the ticks may have a thread of their own."""
        if index == 0:
            self._priority.begin()
            self.note = self._priority.granted
        self._inner.before_tick(index)

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Hand a tick on; whether the run goes on."""
        self._busy_us += times[0]
        if index % LOOK_TICKS == LOOK_TICKS - 1:
            if self._busy_us > FULL * 1e6 * LOOK_TICKS * TICK_S and not self._relented:
                self._priority.end()
                what = f"the ticks took over {FULL:.0%} of the time: they have ordinary priority from here"
                self._relented.append((float(row[0]), what))
            self._busy_us = 0.0
        return self._inner.on_tick(index, row, times)

    def on_end(self) -> list[tuple[float, str]]:
        """Put the priority back and end the other observer."""
        self._priority.end()
        return self._relented + self._inner.on_end()
