"""Number of usable processor cores, and threads that avoid the core of the calling thread."""

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache

_most_cores: list[int] = []


def limit_cores(count: int) -> None:
    """Limit `core_count`, so that this process uses at most ``count`` cores from now on."""
    _most_cores[:] = [count]


def allowed_cores() -> set[int]:
    """Return the cores that the calling thread may use; an empty set if they are unknown."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def core_count() -> int:
    """Return the number of processor cores this process may use."""
    return min(len(allowed_cores()) or os.cpu_count() or 1, *_most_cores, sys.maxsize)


@cache
def _sched_getcpu() -> Callable[[], int] | None:
    return (
        getattr(ctypes.CDLL(None), "sched_getcpu", None)
        if sys.platform.startswith("linux")
        else None
    )


def current_core() -> int | None:
    """Return the core of the calling thread, or None if the system does not report the core."""
    call = _sched_getcpu()
    core = call() if call is not None else -1
    return core if core >= 0 else None


def cores_without(core: int | None, allowed: set[int]) -> set[int]:
    """Return the allowed cores except ``core``, or all allowed cores if no other core is left."""
    return (allowed - {core}) or allowed


class CoreThreads(ThreadPoolExecutor):
    """Pool of threads that do not run on the core of the calling thread.

    An operating system often starts a woken thread on the core of the caller. On this core, the
    woken thread would wait until the caller has finished its own part of the work.

    Parameters
    ----------
    count
        Number of threads.
    """

    def __init__(self, count: int) -> None:
        self._numbers: list[int] = []
        self._avoided: int | None = None
        self._allowed = allowed_cores()
        super().__init__(count, thread_name_prefix="kernel", initializer=self._begin)

    def _begin(self) -> None:
        number = threading.get_native_id()
        self._numbers.append(number)
        self._place(number)

    def keep_off(self, core: int | None) -> None:
        """Prevent the pool's threads from running on ``core``, if another core is allowed."""
        if core != self._avoided:
            self._avoided = core
            for number in self._numbers:
                self._place(number)

    def _place(self, number: int) -> None:
        if self._avoided is not None and self._allowed:
            with suppress(OSError):
                os.sched_setaffinity(number, cores_without(self._avoided, self._allowed))
