"""Start another Python that finds this checkout's packages, ends with this one, and is not
waited for in vain.
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
"""Environment of a process with one thread for linear algebra: sums are then the same on every
machine, and processes do not block each other."""
CHECK_S = 1.0
"""Time between two looks at a process that is waited for [s]."""
IDLE_S = 30.0
"""How long a process that is waited for may do nothing [s]."""
WORK_S = 0.05
"""Processor time that counts as having done something [s]; monitoring the parent's end takes
less.
"""


class HelperLostError(RuntimeError):
    """A helper process ended, was stopped or hangs; the message is half a sentence."""


def child_command(module: str, *arguments: str) -> list[str]:
    """Command that runs ``python -m module arguments`` and ends with this process; empty where
    none can be started.
    """
    strictly = threading.current_thread() is threading.main_thread()
    return python_command(START, str(os.getpid()), str(int(strictly)), module, *arguments)


def end_with(parent: int, *, strictly: bool) -> None:
    """End this process when another has ended, whatever ended that.

    Parameters
    ----------
    parent
        Number of the process that started this one.
    strictly
        Let the system do it, too, where it can (Linux): then it ends though it was stopped. The
        system goes by the thread that started this process, which must not end before its process.
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
    """Judges whether processes that are waited for still work.

    They are given up when they have done nothing for a while, or at the latest after a given time.
    Time counts by checks, so that it does not pass while this process itself was stopped.

    Parameters
    ----------
    processes
        Gives the numbers of the processes; what they have started counts with them.
    longest_s
        How long they may work [s]; None for as long as they do.
    idle_s
        How long they may do nothing [s]; default 30.
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
        """Why to give up, in half a sentence, or None; to be called every `CHECK_S`."""
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
    """Wait until a process prints a line with the word ready first.

    Parameters
    ----------
    child
        The process, with its standard output as a pipe.
    longest_s
        How long it may take [s].
    closes_s
        How long one that printed something else may take to end [s].

    Returns
    -------
    What stands behind the word, and None; or nothing and why it is not ready, in half a
    sentence, which is empty where it has ended.
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
    """Processor time of processes and all that they started [s], and whether one of them is
    stopped.
    """
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
    """Run the module that the command line names, as long as the process that asked for it is
    there.
    """
    parent, strictly, module = (sys.argv.pop(1) for _ in range(3))
    end_with(int(parent), strictly=strictly == "1")
    runpy.run_module(module, run_name="__main__")
