"""Priorities of the thread that computes the ticks of a run, and of background processes.

Priorities are raised during a run if the operating system permits this, and restored afterwards.
"""

import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial

from kernels.cores import allowed_cores, cores_without, current_core

REALTIME = 20
"""Real-time priority of the ticks on Linux, 1 to 99; kernel threads for interrupts have 50."""
NICE = -10
"""Niceness of the ticks on Linux if the system does not permit a real-time priority.

With a niceness of -10, the thread gets 9.3 times the processor time of a thread with niceness 0.
Their weights in the table of the Linux scheduler are 9548 and 1024.
"""
USER_INTERACTIVE = 0x21
DEFAULT = 0x15
"""Default quality-of-service class of a thread on macOS, from the header sys/qos.h.

The thread that computes the ticks gets the class `USER_INTERACTIVE`.
"""
HIGH = 0x80
"""Value of HIGH_PRIORITY_CLASS on Windows, from the header winbase.h."""
USUAL = "ordinary priority"


class TickPriority:
    """Raised priority of the calling thread while ticks are computed, restored by `end`.

    On Linux, the thread gets a real-time priority (SCHED_FIFO), which needs the permission
    ``rtprio`` in /etc/security/limits.conf. Without this permission, the thread gets a niceness
    below 0. Threads and processes that the thread starts do not inherit the real-time priority. On
    Windows, the whole process gets a high priority. On macOS, the thread gets the
    quality-of-service class "user interactive". If the system refuses a setting, `granted` reports
    this and the run continues.

    Attributes
    ----------
    granted
        Description of the priority that the system has granted.
    """

    def __init__(self) -> None:
        self.granted = USUAL
        self._thread = 0
        self._restore: Callable[[], object] | None = None

    def begin(self) -> None:
        """Raise the priority of the calling thread."""
        if self._restore is not None:
            return
        self._thread = threading.get_native_id()
        if sys.platform == "win32":
            self._begin_windows()
        elif sys.platform == "darwin":
            self._begin_macos()
        else:
            self._begin_linux()

    def end(self) -> None:
        """Restore the priority.

        Any thread may call this method, even after the thread with the raised priority has
        ended.
        """
        restore = self._restore
        self._restore = None
        if restore is None:
            return
        self.granted = USUAL
        with suppress(OSError):
            restore()

    def _begin_linux(self) -> None:
        if not hasattr(os, "sched_setscheduler"):
            self.granted = f"{USUAL}: this system offers no other priority"
            return
        try:
            policy = os.sched_getscheduler(self._thread)
            priority = os.sched_getparam(self._thread).sched_priority
            flag = os.SCHED_RESET_ON_FORK  # threads and processes that it starts do not inherit it
            os.sched_setscheduler(self._thread, os.SCHED_FIFO | flag, os.sched_param(REALTIME))
            self._restore = partial(_schedule, self._thread, policy, priority)
            self.granted = f"real-time priority {REALTIME} (SCHED_FIFO)"
            return
        except OSError:
            pass
        try:
            niceness = os.getpriority(os.PRIO_PROCESS, self._thread)
            os.setpriority(os.PRIO_PROCESS, self._thread, NICE)
            self._restore = partial(os.setpriority, os.PRIO_PROCESS, self._thread, niceness)
            self.granted = (
                f"niceness {NICE}: the system grants no real-time priority, see rtprio "
                "in /etc/security/limits.conf"
            )
        except OSError:
            self.granted = (
                f"{USUAL}: the system grants no other priority, see rtprio and nice in "
                "/etc/security/limits.conf"
            )

    def _begin_windows(self) -> None:
        import psutil

        try:
            self._restore = partial(_windows_class, _windows_class(HIGH))
            self.granted = "high priority of the process"
        except (OSError, psutil.Error) as refused:
            self.granted = f"{USUAL}: a higher priority was refused ({refused})"

    def _begin_macos(self) -> None:
        try:
            _macos_class(USER_INTERACTIVE)
            self._restore = self._end_macos
            self.granted = "quality of service of user-interactive threads"
        except (OSError, AttributeError) as refused:
            self.granted = f"{USUAL}: a higher priority was refused ({refused})"

    def _end_macos(self) -> None:
        # macOS can change only the class of the calling thread, and the old class cannot be read.
        if threading.get_native_id() == self._thread:
            _macos_class(DEFAULT)


def _schedule(thread: int, policy: int, priority: int) -> None:
    """Restore the scheduling policy of a thread.

    Without the permission to clear the flag SCHED_RESET_ON_FORK, the thread keeps this flag, which
    is harmless.
    """
    try:
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except PermissionError:
        os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _windows_class(value: int) -> int:
    """Set the priority class of this process and return the previous class."""
    import psutil

    process = psutil.Process()
    before = int(process.nice())
    process.nice(value)
    return before


def _macos_class(value: int) -> None:
    """Set the quality-of-service class of the calling thread."""
    import ctypes

    refused = ctypes.CDLL(None).pthread_set_qos_class_self_np(value, 0)
    if refused:
        raise OSError(refused, os.strerror(refused))


LOWEST = 19
"""Niceness of the lowest ordinary priority.

A process with this niceness gets little processor time while other processes need the processor.
"""


@cache
def may_return_from_idle() -> bool:
    """Return True if this system lets a thread return from idle priority to normal priority.

    The function tests this with a temporary thread.
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
    """Priority of a background process relative to the thread that computes the ticks.

    After `step_back`, the main thread of the process has idle priority and avoids the core on which
    the ticks run. After `hurry`, it has normal priority, because the ticks wait for a result of the
    process. If the system does not let a thread leave the idle priority, the main thread always has
    the lowest ordinary priority instead. Settings that the system refuses or does not support are
    skipped.

    Parameters
    ----------
    number
        Id of the process.
    returns
        True if the system lets a thread leave the idle priority. The default is the result of
        `may_return_from_idle`.
    """

    def __init__(self, number: int, *, returns: bool | None = None) -> None:
        self._number = number
        self._idles = may_return_from_idle() if returns is None else returns
        self._allowed = allowed_cores()
        self._cores = self._allowed
        self._lowered = False

    @property
    def described(self) -> str:
        """Description of the priority and the cores of the process."""
        priority = (
            "idle priority"
            if self._idles
            else f"niceness {LOWEST}"
            if hasattr(os, "setpriority")
            else "as usual"
        )
        return priority + (", off the ticks' core" if len(self._allowed) > 1 else "")

    def step_back(self) -> None:
        """Lower the priority of the process, and exclude it from the core of the calling thread."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_IDLE, os.sched_param(0))
            elif not self._lowered and hasattr(os, "setpriority"):
                self._lowered = True
                os.setpriority(os.PRIO_PROCESS, self._number, LOWEST)
        self._move(cores_without(current_core(), self._allowed))

    def hurry(self) -> None:
        """Raise the priority of the process while the ticks wait for it."""
        with suppress(OSError):
            if self._idles:
                os.sched_setscheduler(self._number, os.SCHED_OTHER, os.sched_param(0))
        self._move(self._allowed)

    def _move(self, cores: set[int]) -> None:
        """Restrict the process to the given cores, unless it is already restricted to them."""
        if cores != self._cores:
            self._cores = cores
            with suppress(OSError):
                os.sched_setaffinity(self._number, cores)
