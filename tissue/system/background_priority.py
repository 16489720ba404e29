"""Priority and cores of a process that works beside the ticks."""

import os
import threading
from contextlib import suppress
from functools import cache

from kernels.cores import allowed_cores, cores_without, current_core

__all__ = ["BackgroundPriority", "may_return_from_idle"]

LOWEST = 19
"""Niceness of a process that takes what others leave."""


@cache
def may_return_from_idle() -> bool:
    """Whether this system lets a thread leave the idle priority again; tried with a thread that
    then ends.
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
    """Puts the main thread of another process of ours behind the ticks, and lets it hurry when it
    is awaited.

    While the ticks go on it runs at idle priority, on the cores that the ticks do not run on. Where
    a thread may not leave the idle priority again it has the lowest of the ordinary ones instead:
    on a machine that others keep busy a process that is awaited at idle priority would hardly ever
    run. What a system refuses or lacks is left out.

    Parameters
    ----------
    number
        The process's id.
    returns
        Whether a thread may leave the idle priority; default: tried.
    """

    def __init__(self, number: int, *, returns: bool | None = None) -> None:
        self._number = number
        self._idles = may_return_from_idle() if returns is None else returns
        self._allowed = allowed_cores()
        self._cores = self._allowed
        self._lowered = False

    @property
    def described(self) -> str:
        """What is asked of the system, in words."""
        priority = (
            "idle priority"
            if self._idles
            else f"niceness {LOWEST}"
            if hasattr(os, "setpriority")
            else "as usual"
        )
        return priority + (", off the ticks' core" if len(self._allowed) > 1 else "")

    def step_back(self) -> None:
        """The ticks go on, on the core of the calling thread."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_IDLE, os.sched_param(0))
            elif not self._lowered and hasattr(os, "setpriority"):
                self._lowered = True
                os.setpriority(os.PRIO_PROCESS, self._number, LOWEST)
        self._move(cores_without(current_core(), self._allowed))

    def hurry(self) -> None:
        """The ticks wait for it."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_OTHER, os.sched_param(0))
        self._move(self._allowed)

    def _move(self, cores: set[int]) -> None:
        """Let it run on these cores; a call that changes nothing is spared."""
        if cores != self._cores:
            self._cores = cores
            with suppress(OSError):
                os.sched_setaffinity(self._number, cores)
