"""Observers of a run, called at every tick: combined, paced by the wall clock, or prioritised.

They are called between ticks and must not change the result of the run.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from time import perf_counter, sleep
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.models.tissue_model import TICK_S
from tissue.simulation.builders.parts import Parts
from tissue.simulation.simulate import RunObserver
from tissue.simulation.trace import NO_LAYER
from tissue.system.priorities import TickPriority

__all__ = [
    "BEHIND_S",
    "LOOK_TICKS",
    "Observers",
    "OnTick",
    "Paced",
    "Prioritised",
    "TickRow",
    "WallClock",
]
LOOK_TICKS = 200
"""Ticks between two checks of the ticks' load and of a live run's processes.

0.2 s is well below the second after which Linux stops a thread that leaves no time.
"""
FULL = 0.9
"""Largest share of the time that ticks may take at a raised priority.

Linux stops a real-time thread that takes 95 % of a second for the rest of that second.
"""
BEHIND = (
    "the ticks were {:.3g} s behind the wall clock in all, which skipped it: the device was "
    "played later than that"
)
BEHIND_S = 0.01
"""Largest lateness of a tick before the lost time is given up [s].

Ten ticks can be caught up without being felt.
"""
SPIN_S = 1.5e-4
"""Time before a tick is due at which sleeping ends and polling the clock begins [s].

A sleep ends up to 0.1 ms late.
"""


class Observers(RunObserver):
    """Several observers combined into one, called in order.

    `on_begin` calls them in reverse order: the first observer of a live run takes over Ctrl-C after
    all other observers have begun.
    """

    def __init__(self, *observers: RunObserver) -> None:
        self._all = observers
        self.timing_columns = tuple(name for each in observers for name in each.timing_columns)
        self.paces = any(each.paces for each in observers)

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
        events: list[tuple[float, str]] = []
        with ExitStack() as ends:
            for each in reversed(self._all):
                ends.callback(lambda each: events.extend(each.on_end()), each)
        return events


class TickRow(Mapping[str, Any]):
    """Row of the trace for one tick, by its columns, such as ``row["model_force_z_N"]``.

    ``row["layer"]`` is the name of a layer, as in the trace. All other values are numbers. It is
    the same object in every tick and shows the present tick. ``dict(row)`` keeps its values.
    """

    def __init__(self, columns: tuple[str, ...], layer_names: tuple[str, ...]) -> None:
        self._places = {name: place for place, name in enumerate(columns)}
        self._layers = (*layer_names, NO_LAYER)
        self.values_of_tick: Array = np.zeros(len(columns))

    def __getitem__(self, name: str) -> Any:
        value = float(self.values_of_tick[self._places[name]])
        return self._layers[int(value)] if name == "layer" else value

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
        self._row = TickRow((), ())

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Store the names of the columns and of the layers."""
        self._row = TickRow(columns, parts.tissue.layer_names)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Call the function."""
        self._row.values_of_tick = row
        answer = self._function(index, self._row)
        return not (isinstance(answer, bool | np.bool_) and not answer)


class WallClock:
    """Wall clock that paces a run.

    Tick i is due i ticks after the start, whatever time the ticks before it took, so nothing
    drifts. A late tick runs at once, and so do the ticks after it until the run is on time again. A
    run that is more than ``behind_s`` late gives up the lost time: its schedule moves by the
    lateness, which is counted. Simulated time is therefore never stretched, and no tick is left
    out. The time skipped on the wall clock is known to the microsecond.

    Parameters
    ----------
    tick_s
        Length of a tick [s].
    behind_s
        Lateness from which the schedule is moved [s].
    now, rest
        Clock [s] and sleep [s].

    Attributes
    ----------
    late_s
        Lateness at the beginning of the present tick [s].
    skipped_s
        Time by which its lateness moved the schedule [s], 0 for most ticks.
    """

    def __init__(
        self,
        tick_s: float,
        *,
        behind_s: float = BEHIND_S,
        now: Callable[[], float] = perf_counter,
        rest: Callable[[float], None] = sleep,
    ) -> None:
        self._tick = require_positive("tick_s", tick_s, "use 1e-3")
        self._behind = require_positive("behind_s", behind_s, "use 0.01")
        self._now = now
        self._rest = rest
        self._start: float | None = None
        self.late_s = self.skipped_s = 0.0

    def wait(self, index: int) -> None:
        """Wait until a tick is due; the first call starts the clock."""
        now = self._now()
        if self._start is None:
            self._start = now - index * self._tick
        due = self._start + index * self._tick
        if due - now > SPIN_S:
            self._rest(due - now - SPIN_S)
            now = self._now()
        while now < due:
            now = self._now()
        self.late_s = now - due
        self.skipped_s = 0.0
        if self.late_s > self._behind:
            self._start += self.late_s
            self.skipped_s = self.late_s

    def hold(self, seconds: float) -> None:
        """Move the schedule by a pause of the run, which does not count as lateness."""
        if self._start is not None:
            self._start += seconds


class Paced(RunObserver):
    """Observer that starts each tick when it is due, for a run moved by a real device."""

    paces = True

    def __init__(self, clock: WallClock | None = None) -> None:
        self._clock = clock or WallClock(TICK_S)
        self._skipped_s = 0.0

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due."""
        self._clock.wait(index)
        self._skipped_s += self._clock.skipped_s

    def on_end(self) -> list[tuple[float, str]]:
        """Return an event with the time by which the wall clock was missed."""
        return [(0.0, BEHIND.format(self._skipped_s))] if self._skipped_s > 0.0 else []


class Prioritised(RunObserver):
    """Observer that raises the priority of the ticks' thread and restores it at the end.

    It is restored earlier if the ticks leave no time to other threads. The system would then stop
    the ticks for longer than ordinary priority delays them.

    Attributes
    ----------
    note
        Priority of the ticks, as text.
    """

    def __init__(self, priority: TickPriority | None = None) -> None:
        self.note = ""
        self._priority = priority or TickPriority()
        self._busy_us = 0.0
        self._restored: list[tuple[float, str]] = []

    def before_tick(self, index: int) -> None:
        """Raise the priority before the first tick, since ticks may run in their own thread."""
        if index == 0:
            self._priority.begin()
            self.note = self._priority.granted

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Check the load of the ticks at intervals."""
        self._busy_us += times[0]
        if index % LOOK_TICKS == LOOK_TICKS - 1:
            if self._busy_us > FULL * 1e6 * LOOK_TICKS * TICK_S and not self._restored:
                self._priority.end()
                what = (
                    f"the ticks took over {FULL:.0%} of the time: they have ordinary priority "
                    "from here"
                )
                self._restored.append((float(row[0]), what))
            self._busy_us = 0.0
        return True

    def on_end(self) -> list[tuple[float, str]]:
        """Restore the priority."""
        self._priority.end()
        return self._restored
