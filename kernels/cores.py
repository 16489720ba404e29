"""Processor cores: how many this process may use, on which one a thread runs, and threads that
keep off it.
"""

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache

__all__ = [
    "CoreThreads",
    "allowed_cores",
    "core_count",
    "cores_without",
    "current_core",
    "limit_cores",
]

_most_cores: list[int] = []


def limit_cores(count: int) -> None:
    """Let what this process begins from now on use at most so many cores."""
    _most_cores[:] = [count]


def allowed_cores() -> set[int]:
    """Cores that the calling thread may run on; empty where the system does not report them."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def core_count() -> int:
    """Processor cores this process may use."""
    return min(len(allowed_cores()) or os.cpu_count() or 1, *_most_cores, sys.maxsize)


@cache
def _sched_getcpu() -> Callable[[], int] | None:
    return (
        getattr(ctypes.CDLL(None), "sched_getcpu", None)
        if sys.platform.startswith("linux")
        else None
    )


def current_core() -> int | None:
    """Core that the calling thread runs on at this moment, None where the system does not report
    it.
    """
    call = _sched_getcpu()
    core = call() if call is not None else -1
    return core if core >= 0 else None


def cores_without(core: int | None, allowed: set[int]) -> set[int]:
    """The allowed cores but one; all of them where nothing would be left."""
    return (allowed - {core}) or allowed


class CoreThreads(ThreadPoolExecutor):
    """Threads that share the work of another one, on other cores than that.

    A system often wakes a thread on the core of the one that wakes it, where it would wait for that
    one's work to end.

    Parameters
    ----------
    count
        How many threads.
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
        """Let no thread run on this core from now on, where there is another one."""
        if core != self._avoided:
            self._avoided = core
            for number in self._numbers:
                self._place(number)

    def _place(self, number: int) -> None:
        if self._avoided is not None and self._allowed:
            with suppress(OSError):
                os.sched_setaffinity(number, cores_without(self._avoided, self._allowed))
