"""Ticks against the wall clock: when each one is due, how late it began, and what happens when they fall behind."""

from collections.abc import Callable
from time import perf_counter, sleep

from meshes.base.errors import require_positive

__all__ = ["BEHIND_S", "WallClock"]

BEHIND_S = 0.01
"""How late a tick may begin before what is lost is given up [s]: ten ticks can be made up without being felt."""
SPIN_S = 1.5e-4
"""How long before a tick is due sleeping ends and looking at the clock begins [s]: a sleep ends up to 0.1 ms late."""


class WallClock:
    """The wall clock as a run follows it.

    Tick i is due i ticks after the start, whatever the ticks before it took, so that nothing drifts. A tick that comes
    too late is made at once, and those after it until the run is on time again. A run that is more than ``behind_s``
    late gives up what it has lost: its schedule is moved by the lateness, which is counted. Simulated time is so never
    stretched and no tick is left out; what was skipped on the wall is known to the microsecond.

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
        self._now, self._rest = now, rest
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
        self.late_s, self.skipped_s = now - due, 0.0
        if self.late_s > self._behind:
            self._start += self.late_s
            self.skipped_s = self.late_s

    def hold(self, seconds: float) -> None:
        """Move the schedule by a pause of the run, which is no lateness."""
        if self._start is not None:
            self._start += seconds
