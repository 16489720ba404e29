"""Real-time pacing of ticks: due times, lateness, and the priority of their thread."""

from collections.abc import Callable
from time import perf_counter, sleep

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import require_positive
from tissue.models.tissue_model import TICK_S
from tissue.simulation.observer import RunObserver
from tissue.system.priorities import TickPriority

__all__ = ["BEHIND_S", "LOOK_TICKS", "Paced", "Prioritised", "WallClock"]

LOOK_TICKS = 200
"""Ticks between two checks of the ticks' load and of a live run's processes."""
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

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
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
