"""Priority of the thread that runs ticks in real time.

The priority is raised if the system permits it, and restored afterwards.
"""

import os
import sys
import threading
from contextlib import suppress

__all__ = ["TickPriority"]

REALTIME = 20
"""Real-time priority on Linux, 1 to 99; kernel threads that serve devices have 50."""
NICE = -10
"""Niceness requested if no real-time priority is granted."""
USER_INTERACTIVE, DEFAULT = 0x21, 0x15
"""Quality-of-service classes of macOS, from its header sys/qos.h."""
HIGH = 0x80
"""HIGH_PRIORITY_CLASS of Windows, from its header winbase.h."""
USUAL = "ordinary priority"


class TickPriority:
    """Priority of the calling thread, raised while ticks run and restored afterwards.

    Linux: real-time priority (SCHED_FIFO), which needs the permission ``rtprio`` in
    /etc/security/limits.conf, otherwise a niceness below 0. Both apply to the thread only. Threads
    and processes that it starts do not inherit the real-time priority. Windows: high priority of
    the process. macOS: the quality-of-service class of user interaction. Whatever the system does
    not grant is noted in `granted` and never ends a run.

    Attributes
    ----------
    granted
        Description of the current priority.
    """

    def __init__(self) -> None:
        self.granted = USUAL
        self._thread = 0
        self._before: tuple[str, int, int] | None = None

    def begin(self) -> None:
        """Raise the priority of the calling thread."""
        if self._before is not None:
            return
        self._thread = threading.get_native_id()
        if sys.platform == "win32":
            self._begin_windows()
        elif sys.platform == "darwin":
            self._begin_macos()
        else:
            self._begin_linux()

    def end(self) -> None:
        """Restore the priority, from any thread; a thread that has ended is skipped."""
        before = self._before
        self._before = None
        if before is None:
            return
        self.granted = USUAL
        kind, value, detail = before
        with suppress(OSError):
            if kind == "policy":
                _schedule(self._thread, value, detail)
            elif kind == "niceness":
                os.setpriority(os.PRIO_PROCESS, self._thread, value)
            elif kind == "class":
                _windows_class(value)
            elif threading.get_native_id() == self._thread:
                _macos_class(DEFAULT)

    def _begin_linux(self) -> None:
        if not hasattr(os, "sched_setscheduler"):
            self.granted = f"{USUAL}: this system offers no other"
            return
        try:
            before = (
                os.sched_getscheduler(self._thread),
                os.sched_getparam(self._thread).sched_priority,
            )
            flag = os.SCHED_RESET_ON_FORK  # threads and processes started here do not inherit it
            os.sched_setscheduler(self._thread, os.SCHED_FIFO | flag, os.sched_param(REALTIME))
            self._before = ("policy", *before)
            self.granted = f"real-time priority {REALTIME} (SCHED_FIFO)"
            return
        except OSError:
            pass
        try:
            niceness = os.getpriority(os.PRIO_PROCESS, self._thread)
            os.setpriority(os.PRIO_PROCESS, self._thread, NICE)
            self._before = ("niceness", niceness, 0)
            self.granted = (
                f"niceness {NICE}: no real-time priority is granted, see rtprio in "
                "/etc/security/limits.conf"
            )
        except OSError:
            self.granted = (
                f"{USUAL}: no other is granted, see rtprio and nice in /etc/security/limits.conf"
            )

    def _begin_windows(self) -> None:
        import psutil

        try:
            self._before = ("class", _windows_class(HIGH), 0)
            self.granted = "high priority of the process"
        except (OSError, psutil.Error) as refused:
            self.granted = f"{USUAL}: a higher one was refused ({refused})"

    def _begin_macos(self) -> None:
        try:
            _macos_class(USER_INTERACTIVE)
            self._before = ("quality", 0, 0)
            self.granted = "quality of service of what a person interacts with"
        except (OSError, AttributeError) as refused:
            self.granted = f"{USUAL}: a higher one was refused ({refused})"


def _schedule(thread: int, policy: int, priority: int) -> None:
    """Restore the scheduling policy of a thread.

    Without permission to clear SCHED_RESET_ON_FORK, the thread keeps this harmless flag.
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
