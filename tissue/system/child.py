"""Start of child Python processes that use this checkout and end with this process.

`HangDetector` detects child processes that no longer work.
"""

import os
import runpy
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from queue import Empty, SimpleQueue
from time import sleep

from meshes.base.child_process import kill_with_parent, python_command, start_code

__all__ = [
    "CHECK_S",
    "ONE_THREAD",
    "HangDetector",
    "HelperLostError",
    "await_ready",
    "child_command",
    "end_with",
]

START = start_code("tissue.system.child", "_main")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment that limits linear algebra to one thread.

Sums are then equal on every machine, and processes do not compete for cores.
"""
CHECK_S = 1.0
"""Time between two checks of an awaited process [s]."""
IDLE_S = 30.0
"""Longest idle time of an awaited process [s]."""
WORK_S = 0.05
"""Processor time that counts as work [s]; the check for the end of the parent process takes less.
"""


class HelperLostError(RuntimeError):
    """Error of a lost helper process: it ended, was stopped or hangs.

    The message is half a sentence.
    """


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs ``python -m module arguments`` and ends with this process.

    The command is empty if no Python can be started.
    """
    strictly = threading.current_thread() is threading.main_thread()
    return python_command(START, str(os.getpid()), str(int(strictly)), module, *arguments)


def end_with(parent: int, *, strictly: bool) -> None:
    """End this process when the parent process has ended for any reason.

    Parameters
    ----------
    parent
        Id of the process that started this one.
    strictly
        Also let the system end this process, where it can (Linux). It then ends even if it was
        stopped. The system observes the thread that started this process. That thread must not end
        before its process.
    """
    if strictly:
        kill_with_parent()
    threading.Thread(target=_await_end, args=(parent,), daemon=True).start()


def _await_end(parent: int) -> None:
    if sys.platform == "win32":
        import psutil

        if psutil.pid_exists(parent):
            psutil.Process(parent).wait()
    else:
        while os.getppid() == parent:
            sleep(0.5)
    os._exit(1)


class HangDetector:
    """Detector for awaited processes that no longer work.

    A process is given up when it has been idle too long, or has taken longer than a given time.
    Time is counted in checks, so that time during which this process was stopped does not count.

    Parameters
    ----------
    processes
        Returns the ids of the processes. Their child processes are included.
    longest_s
        Longest working time [s]; None for no limit.
    idle_s
        Longest idle time [s]; default 30.
    """

    def __init__(
        self,
        processes: Callable[[], Iterable[int]],
        *,
        longest_s: float | None = None,
        idle_s: float | None = None,
    ) -> None:
        self._processes = processes
        self._longest_s = longest_s
        self._idle_s = idle_s or IDLE_S
        self._waited_s = 0.0
        self._idle_since_s = 0.0
        self._work_s = -WORK_S

    def check(self) -> str | None:
        """Return the reason to give up, in half a sentence, or None; call it every `CHECK_S`."""
        self._waited_s += CHECK_S
        work_s, stopped = _work_of(self._processes())
        if abs(work_s - self._work_s) >= WORK_S:
            self._work_s = work_s
            self._idle_since_s = self._waited_s
        if self._waited_s - self._idle_since_s >= self._idle_s:
            return (
                f"{'was stopped' if stopped else 'hangs'} and has done nothing for "
                f"{self._idle_s:g} s"
            )
        if self._longest_s is not None and self._waited_s >= self._longest_s:
            return f"took longer than {self._longest_s:g} s"
        return None


def await_ready(
    child: "subprocess.Popen[str]", *, longest_s: float, closes_s: float
) -> tuple[str, str | None]:
    """Wait until a process prints a line that starts with the word ready.

    Parameters
    ----------
    child
        The process, with its standard output as a pipe.
    longest_s
        Longest waiting time [s].
    closes_s
        Longest time to end for a process that printed something else [s].

    Returns
    -------
    The text after the word, and None. If the process is not ready: an empty text, and the reason in
    half a sentence, which is empty if the process has ended.
    """
    stdout = child.stdout
    first = SimpleQueue[str]()
    detector = HangDetector(lambda: [child.pid], longest_s=longest_s)
    assert stdout is not None
    threading.Thread(target=lambda: first.put(stdout.readline()), daemon=True).start()
    while True:
        try:
            word, _, rest = first.get(timeout=CHECK_S).strip().partition(" ")
            if word == "ready":
                return rest, None
            child.wait(closes_s)
            return "", ""
        except Empty:
            why = detector.check()
        except subprocess.TimeoutExpired:
            return "", "its process does not answer"
        if why is not None:
            return "", f"it {why}"


def _work_of(processes: Iterable[int]) -> tuple[float, bool]:
    """Return the processor time of processes and their children [s], and whether one is stopped."""
    import psutil

    work_s = 0.0
    stopped = False
    for number in processes:
        try:
            process = psutil.Process(number)
            for each in (process, *process.children(recursive=True)):
                times = each.cpu_times()
                work_s += times.user + times.system
                stopped = stopped or each.status() == psutil.STATUS_STOPPED
        except psutil.Error:
            continue
    return work_s, stopped


def _main() -> None:
    """Run the module named on the command line while the parent process lives."""
    parent, strictly, module = (sys.argv.pop(1) for _ in range(3))
    end_with(int(parent), strictly=strictly == "1")
    runpy.run_module(module, run_name="__main__")
