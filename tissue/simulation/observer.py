"""Observers that are called in every tick of a run, such as the wall clock.

Observers must not change the result of the run.
"""

from collections.abc import Callable, Iterator, Mapping
from time import perf_counter, sleep
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import Events
from tissue.simulation.builders.parts import Parts
from tissue.simulation.simulate import RunObserver
from tissue.simulation.trace import NO_LAYER
from tissue.system.priorities import TickPriority

LOOK_TICKS = 200
"""Interval between two checks of a live run [ticks].

A check reads the processor time of the ticks, and tests if the other processes of the run still
exist.

The interval of 0.2 s is shorter than the 1 s after which Linux stops a thread that leaves no time
to other threads.
"""
FULL = 0.9
"""Largest share of the processor time that the ticks may use at a raised priority.

When real-time threads have used 95 % of a second, Linux stops them for the rest of the second.
"""
BEHIND = (
    "the ticks were {:.3g} s behind the wall clock in all. The schedule was moved by "
    "this time, so the device received its forces later than the trace states"
)
BEHIND_S = 0.01
"""Largest lateness of a tick [s] for which the following ticks run without waiting.

Ticks wait again when the run is on time. After a larger lateness, the schedule is moved. A person
does not feel that up to ten ticks run faster than real time.
"""
SPIN_S = 1.5e-4
"""Time before a tick is due [s] at which the thread stops sleeping and polls the clock.

A sleep may end up to 0.1 ms late.
"""


class TickRow(Mapping[str, Any]):
    """Row of the trace for one tick, keyed by column, such as ``row["model_force_z_N"]``.

    ``row["layer"]`` is the name of a layer, as in the trace. All other values are numbers. The same
    object is used in every tick, so its values change. To keep the values of a tick, copy them with
    ``dict(row)``.
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
    """Observer that calls a function with the number and the row of each tick.

    The run ends when the function returns False.
    """

    def __init__(self, function: Callable[[int, TickRow], Any]) -> None:
        self._function = function
        self._row = TickRow((), ())

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Store the names of the trace columns and of the layers."""
        self._row = TickRow(columns, parts.tissue.layer_names)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Call the function, and return True if the run continues."""
        self._row.values_of_tick = row
        answer = self._function(index, self._row)
        return not (isinstance(answer, bool | np.bool_) and not answer)


class WallClock:
    """Schedule that starts the ticks of a run in real time.

    Tick i is due i milliseconds after the start, regardless of the duration of earlier ticks.
    Delays therefore do not accumulate. After a late tick, ticks run without waiting until the run
    is on time again. If a tick is late by more than `BEHIND_S`, all later ticks are postponed by
    the lateness. The lateness is then counted as skipped time. The simulated time of a tick never
    changes, and no tick is left out. The skipped time is recorded with microsecond resolution.

    Attributes
    ----------
    late_s
        Lateness at the beginning of the current tick [s].
    skipped_s
        Time by which the schedule was moved at the current tick [s]; 0 for most ticks.
    """

    def __init__(self) -> None:
        self._start: float | None = None
        self.late_s = self.skipped_s = 0.0

    def wait(self, index: int) -> None:
        """Wait until a tick is due; the first call starts the clock."""
        now = perf_counter()
        if self._start is None:
            self._start = now - index * TICK_S
        due = self._start + index * TICK_S
        if due - now > SPIN_S:
            sleep(due - now - SPIN_S)
            now = perf_counter()
        while now < due:
            now = perf_counter()
        self.late_s = now - due
        self.skipped_s = 0.0
        if self.late_s > BEHIND_S:
            self._start += self.late_s
            self.skipped_s = self.late_s

    def hold(self, seconds: float) -> None:
        """Move the schedule by the duration of a pause, which does not count as lateness."""
        if self._start is not None:
            self._start += seconds


class Paced(RunObserver):
    """Observer that starts each tick when it is due, for a run with a real device."""

    paces = True

    def __init__(self) -> None:
        self._clock = WallClock()
        self._skipped_s = 0.0

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due."""
        self._clock.wait(index)
        self._skipped_s += self._clock.skipped_s

    def on_end(self) -> Events:
        """Return an event with the skipped time of the whole run."""
        return [(0.0, BEHIND.format(self._skipped_s))] if self._skipped_s > 0.0 else []


class Prioritised(RunObserver):
    """Observer that raises the priority of the thread that runs the ticks, until the run ends.

    The priority is restored earlier if the ticks use more than the share `FULL` of the time. The
    system would otherwise stop the thread for longer than the delays at an ordinary priority.

    Attributes
    ----------
    note
        Text about the priority of the thread that runs the ticks.
    """

    def __init__(self, priority: TickPriority | None = None) -> None:
        self.note = ""
        self._priority = priority or TickPriority()
        self._busy_us = 0.0
        self._restored: Events = []

    def before_tick(self, index: int) -> None:
        """Raise the priority before the first tick, in the thread that runs the ticks."""
        if index == 0:
            self._priority.begin()
            self.note = self._priority.granted

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Check the processor time used by the ticks, every `LOOK_TICKS` ticks."""
        self._busy_us += times[0]
        if index % LOOK_TICKS == LOOK_TICKS - 1:
            if self._busy_us > FULL * 1e6 * LOOK_TICKS * TICK_S and not self._restored:
                self._priority.end()
                what = (
                    f"the ticks took over {FULL:.0%} of the time: from now on they have "
                    "ordinary priority"
                )
                self._restored.append((float(row[0]), what))
            self._busy_us = 0.0
        return True

    def on_end(self) -> Events:
        """Restore the priority."""
        self._priority.end()
        return self._restored
