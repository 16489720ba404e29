"""Priority and processor cores of a process that runs concurrently with the ticks."""

import os
import threading
from contextlib import suppress
from functools import cache

from kernels.cores import allowed_cores, cores_without, current_core

__all__ = ["BackgroundPriority", "may_return_from_idle"]

LOWEST = 19
"""Lowest niceness: the process runs when no other process needs the processor."""


@cache
def may_return_from_idle() -> bool:
    """Return whether this system lets a thread leave the idle priority again.

    A short-lived thread tries it.
    """
    if not hasattr(os, "SCHED_IDLE"):
        return False
    returned: list[bool] = []

    def attempt() -> None:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            returned.append(True)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return bool(returned)


class BackgroundPriority:
    """Priority of a background process relative to the ticks.

    While the ticks run, the main thread of the process has idle priority and avoids the core of the
    ticks. It gets normal priority when the ticks wait for it. If a thread cannot leave the idle
    priority again, it gets the lowest ordinary priority instead. On a busy machine, an awaited
    process at idle priority would hardly ever run. Settings that the system refuses or lacks are
    skipped.

    Parameters
    ----------
    number
        Id of the process.
    returns
        True if a thread may leave the idle priority. By default, `may_return_from_idle` tests it.
    """

    def __init__(self, number: int, *, returns: bool | None = None) -> None:
        self._number = number
        self._idles = may_return_from_idle() if returns is None else returns
        self._allowed = allowed_cores()
        self._cores = self._allowed
        self._lowered = False

    @property
    def described(self) -> str:
        """Description of the requested priority and cores."""
        priority = (
            "idle priority"
            if self._idles
            else f"niceness {LOWEST}"
            if hasattr(os, "setpriority")
            else "as usual"
        )
        return priority + (", off the ticks' core" if len(self._allowed) > 1 else "")

    def step_back(self) -> None:
        """Lower the priority while the ticks run on the core of the calling thread."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_IDLE, os.sched_param(0))
            elif not self._lowered and hasattr(os, "setpriority"):
                self._lowered = True
                os.setpriority(os.PRIO_PROCESS, self._number, LOWEST)
        self._move(cores_without(current_core(), self._allowed))

    def hurry(self) -> None:
        """Raise the priority while the ticks wait for the process."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_OTHER, os.sched_param(0))
        self._move(self._allowed)

    def _move(self, cores: set[int]) -> None:
        """Restrict the process to these cores, unless it already has them."""
        if cores != self._cores:
            self._cores = cores
            with suppress(OSError):
                os.sched_setaffinity(self._number, cores)
