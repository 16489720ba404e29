"""Ticks against the wall clock: when each tick is due, how late it began, and the priority of
its thread.
"""

from collections.abc import Callable
from time import perf_counter, sleep

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import require_positive
from tissue.models.tissue_model import TICK_S
from tissue.simulation.observer import RunObserver
from tissue.system.tick_priority import TickPriority

__all__ = ["BEHIND_S", "LOOK_TICKS", "Paced", "Prioritised", "WallClock"]

LOOK_TICKS = 200
"""Ticks between two looks at the load of the ticks and at the processes of a live run."""
FULL = 0.9
"""Share of the time that ticks may take at a raised priority. Linux stops a real-time thread that
takes 95 % of a second for the rest of it."""
BEHIND = (
    "the ticks were {:.3g} s behind the wall clock in all, which skipped it: the device was "
    "played later than that"
)

BEHIND_S = 0.01
"""How late a tick may begin before what is lost is given up [s]: ten ticks can be made up
without being felt.
"""
SPIN_S = 1.5e-4
"""How long before a tick is due sleeping ends and looking at the clock begins [s]: a sleep ends
up to 0.1 ms late.
"""


class WallClock:
    """The wall clock as a run follows it.

    Tick i is due i ticks after the start, whatever the ticks before it took, so that nothing
    drifts. A tick that comes too late is made at once, and those after it until the run is on time
    again. A run that is more than ``behind_s`` late gives up what it has lost: its schedule is
    moved by the lateness, which is counted. Simulated time is so never stretched and no tick is
    left out; what was skipped on the wall is known to the microsecond.

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
        How late the present tick began [s].
    skipped_s
        What its lateness moved the schedule by [s], 0 for most ticks.
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
        """Move the schedule by a pause of the run, which is no lateness."""
        if self._start is not None:
            self._start += seconds


class Paced(RunObserver):
    """Starts each tick when it is due, for a run that a real device moves."""

    def __init__(self, clock: WallClock | None = None) -> None:
        self._clock = clock or WallClock(TICK_S)
        self._skipped_s = 0.0

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due."""
        self._clock.wait(index)
        self._skipped_s += self._clock.skipped_s

    def on_end(self) -> list[tuple[float, str]]:
        """Return by how much the wall clock was missed."""
        return [(0.0, BEHIND.format(self._skipped_s))] if self._skipped_s > 0.0 else []


class Prioritised(RunObserver):
    """Raises the priority of the thread of the ticks, and restores it at the end.

    It is restored earlier if the ticks would leave no time to others: the system would then stop
    them for longer than ordinary priority delays them.

    Attributes
    ----------
    note
        Priority of the ticks, in words.
    """

    def __init__(self, priority: TickPriority | None = None) -> None:
        self.note = ""
        self._priority = priority or TickPriority()
        self._busy_us = 0.0
        self._restored: list[tuple[float, str]] = []

    def before_tick(self, index: int) -> None:
        """Raise the priority before the first tick: the ticks may have a thread of their own."""
        if index == 0:
            self._priority.begin()
            self.note = self._priority.granted

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Look at the load of the ticks now and then."""
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
