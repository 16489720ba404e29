"""Child Python processes that end when this process ends.

`Helper` exchanges messages with a child process. `HangDetector` detects processes that hang.
"""

import os
import pickle
import runpy
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterable
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import sleep
from typing import Any, TextIO

from meshes.base.errors import InputError
from meshes.base.isolated_parser import kill_with_parent, python_command, start_code

START = start_code("tissue.system.child", "_main")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables that limit linear algebra to one thread.

With one thread, the rounding of sums is equal on every computer, and processes do not compete for
cores.
"""
CHECK_S = 1.0
"""Time between two checks for a hanging process [s]; a check takes about 10 ms."""
IDLE_S = 30.0
"""Idle time after which a process is treated as hanging [s].

It is 20 times the longest delay of a tick that was measured on an overloaded computer, 1.5 s
(`docs/performance.md`).
"""
WORK_S = 0.05
"""Processor time between two checks above which a process is not idle [s].

A process that waits, and checks whether its parent process has ended, uses less time.
"""


class HelperLostError(RuntimeError):
    """Error for a helper process that has ended, was stopped or hangs.

    The message is part of a sentence, which the caller completes.
    """


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command of a child process that runs ``python -m module arguments``.

    The child process ends when this process ends. The list is empty if Python cannot be started.
    """
    strictly = threading.current_thread() is threading.main_thread()
    return python_command(START, str(os.getpid()), str(int(strictly)), module, *arguments)


def process_module(name: str) -> str:
    """Return the module that a live-run process with a name such as ``window`` executes.

    The modules are entry points of the group ``tissue.processes``.

    Raises
    ------
    InputError
        If the installed package has no such entry point.
    """
    from importlib.metadata import entry_points  # 0.04 s, which every command would pay

    for found in entry_points(group="tissue.processes", name=name):
        return found.value
    raise InputError(
        "tissue-sim",
        f"have the process {name}",
        "an older version of it",
        "install tissue-sim again",
    )


def end_with(parent: int, *, strictly: bool) -> None:
    """End this process as soon as the parent process has ended for any reason.

    Parameters
    ----------
    parent
        Id of the process that started this process.
    strictly
        True to make the operating system end this process, in addition to the check in this process
        (Linux only). The system then ends this process even while a stop signal suspends it. The
        system also ends this process if the thread that started it ends. That thread must therefore
        live as long as the parent process.
    """
    if strictly:
        kill_with_parent()
    threading.Thread(target=_await_end, args=(parent,), daemon=True).start()


def _await_end(parent: int) -> None:
    if sys.platform == "win32":
        import psutil

        # On Windows the id of the parent stays the same after its end.
        if psutil.pid_exists(parent):
            psutil.Process(parent).wait()
    else:
        while os.getppid() == parent:
            # The id of the parent process changes when it ends. In IDLE_S, polling uses less
            # processor time than WORK_S.
            sleep(0.5)
    os._exit(1)


class HangDetector:
    """Detector for hanging processes.

    The detector reports a hang if the processes were idle for `IDLE_S`, or have taken longer than
    `longest_s`. It counts checks instead of reading a clock, so time during which this process is
    suspended does not count.

    Parameters
    ----------
    processes
        Function that returns the ids of the processes to check. Child processes of these processes
        are also checked.
    longest_s
        Longest time that the processes may take [s]; None for no limit.
    """

    def __init__(
        self,
        processes: Callable[[], Iterable[int]],
        *,
        longest_s: float | None = None,
    ) -> None:
        self._processes = processes
        self._longest_s = longest_s
        self._waited_s = 0.0
        self._idle_since_s = 0.0
        # The first check is then treated as work, so that the idle time starts there.
        self._work_s = -WORK_S

    def check(self) -> str | None:
        """Return the reason why the processes hang, or None; call this method every `CHECK_S`.

        The reason is part of a sentence.
        """
        self._waited_s += CHECK_S
        work_s, stopped = _work_of(self._processes())
        # The sum decreases when a child of the process has ended.
        if abs(work_s - self._work_s) >= WORK_S:
            self._work_s = work_s
            self._idle_since_s = self._waited_s
        if self._waited_s - self._idle_since_s >= IDLE_S:
            return f"{'was stopped' if stopped else 'hangs'} and has done nothing for {IDLE_S:g} s"
        if self._longest_s is not None and self._waited_s >= self._longest_s:
            return f"took longer than {self._longest_s:g} s"
        return None


def await_ready(
    child: "subprocess.Popen[str]", *, longest_s: float, closes_s: float
) -> tuple[str, str | None]:
    """Wait until a process prints a line that starts with ``ready``.

    Parameters
    ----------
    child
        The process; its standard output must be a pipe.
    longest_s
        Longest waiting time [s].
    closes_s
        Longest time [s] that the process may take to end if its first line does not start with
        ``ready``.

    Returns
    -------
    The text after ``ready``, and None. If the process does not become ready, an empty text, and the
    reason as part of a sentence. The reason is an empty text if the process has ended by itself.
    """
    stdout = child.stdout
    first = SimpleQueue[str]()
    detector = HangDetector(lambda: [child.pid], longest_s=longest_s)
    assert stdout is not None
    threading.Thread(target=lambda: first.put(stdout.readline()), daemon=True).start()
    while True:
        try:
            word, _, rest = first.get(timeout=CHECK_S).strip().partition(" ")
            # After the end of the output, or after another line, the process ends by itself.
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
    """Return processor time [s] of processes and their children, and whether any is stopped."""
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


NICE = 5
"""Niceness (Linux) of a process that draws or publishes a run while the ticks are computed.

If a process with niceness 5 and a process with niceness 0 need the same core, the first gets a
third of the time of the second. Their weights are 335 and 1024 in the table
``sched_prio_to_weight`` of Linux. The value is a design choice.
"""


def own_process(*, beside_ticks: bool) -> TextIO:
    """Prepare this process for drawing or publishing a run; return its standard output.

    Other output of the process goes to standard error. The parent process decides when this process
    ends, so Ctrl-C is ignored. With `beside_ticks` (another process computes ticks), this process
    gets a lower priority and draws with one thread. Otherwise, software OpenGL would use all cores.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if beside_ticks:
        # Windows has no niceness
        if hasattr(os, "nice"):
            os.nice(NICE)
        os.environ.setdefault("LP_NUM_THREADS", "1")
    # libraries may print to standard output, whose reader waits for the line "ready"; such text
    # goes to standard error
    standard_output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return standard_output


def _main() -> None:
    """Run the module that is named on the command line, until the parent process ends."""
    parent, strictly, module = (sys.argv.pop(1) for _ in range(3))
    end_with(int(parent), strictly=strictly == "1")
    runpy.run_module(module, run_name="__main__")


ENDS_S = 10.0
"""Longest time that a helper process may take to end after its input was closed [s].

After this time, the process is killed. A process usually ends within milliseconds.
"""
Job = Callable[[], None]


class Helper:
    """Child Python process that receives pickled messages and answers them.

    Messages are written to the helper's standard input, and answers are read from the helper's
    standard output. The helper ends when this process ends, and uses one thread for linear algebra.
    In this process, a separate thread writes messages and reads answers, so that `send` never
    blocks.

    Parameters
    ----------
    module
        Module that the helper runs.
    does
        Task of the helper, as a verb phrase for error messages. Example: ``solves the stress``
        gives "the process that solves the stress".

    Attributes
    ----------
    priority
        Object that sets the priority of the helper relative to the ticks of a run.
    """

    def __init__(self, module: str, *, does: str) -> None:
        # The import loads Warp and may fail. No process may be running at that time, because before
        # `weakref.finalize` nothing would end the process.
        from tissue.system.priorities import BackgroundPriority

        pipe = subprocess.PIPE
        # With its own process group, the helper does not receive Ctrl-C. With its own session, its
        # priority relative to this process would have no effect, because Linux may first share the
        # processor among sessions.
        self._process = subprocess.Popen(
            child_command(module),
            stdin=pipe,
            stdout=pipe,
            process_group=0,
            env=os.environ | ONE_THREAD,
        )
        self.priority = BackgroundPriority(self._process.pid)
        self._does = does
        self._answers: SimpleQueue[Any] = SimpleQueue()
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        threading.Thread(target=_work, args=(self._jobs,), daemon=True).start()
        self.kill = weakref.finalize(self, _kill, self._process, self._jobs)
        """Kill the helper; a second call has no effect."""

    @property
    def number(self) -> int:
        """Process id of the helper."""
        return self._process.pid

    def send(self, message: object) -> None:
        """Send a message and return at once."""
        # To send an array of 80 MB takes 0.24 s; with the default protocol it takes 0.32 s.
        data = pickle.dumps(message, protocol=5)
        stream = self._process.stdin
        assert stream is not None

        def write() -> None:
            with suppress(OSError, ValueError):  # the helper has ended; `receive` reports it
                stream.write(data)  # one write: a part of the message would wake the helper
                stream.flush()

        self._jobs.put(write)

    def receive(self, *, longest_s: float) -> Any:
        """Wait for the next answer; if an error was raised in the helper, raise it here.

        Raises
        ------
        HelperLostError
            If the helper has ended, is idle for too long, or takes longer than `longest_s`. The
            helper is then killed.
        """
        stream = self._process.stdout
        answers = self._answers
        assert stream is not None
        if not self.kill.alive:
            raise self._lost()

        def read() -> None:
            try:
                answers.put(pickle.load(stream))
            except (EOFError, OSError, ValueError, pickle.UnpicklingError) as problem:
                answers.put(_Ended(str(problem)))

        self._jobs.put(read)
        detector = HangDetector(lambda: [self.number], longest_s=longest_s)
        while True:
            try:
                answer = answers.get(timeout=CHECK_S)
                break
            except Empty:
                why = detector.check()
                if why is not None:
                    self.kill()
                    raise self._lost(why) from None
            except BaseException:
                # for example Ctrl-C: a later call would read this answer as the answer to its
                # message
                self.kill()
                raise
        if isinstance(answer, _Ended):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDS_S)
            self.kill()
            raise self._lost()
        if isinstance(answer, BaseException):
            self.end()
            raise answer
        return answer

    def _lost(self, why: str = "") -> HelperLostError:
        """Return the error for a lost helper; if no reason is given, the helper has ended."""
        return HelperLostError(
            f"the process that {self._does} {why or _how_ended(self._process.returncode)}"
        )

    def end(self) -> None:
        """End the helper by closing its standard input."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        self.kill()


def _how_ended(code: int) -> str:
    """Return a text that describes how a process ended, from its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    # If a signal ended a process, its exit code is the negative number of the signal.
    name = next((each.name for each in signal.Signals if each == -code), f"signal {-code}")
    return f"was ended by {name}" + (" (memory may have run out)" if name == "SIGKILL" else "")


class _Ended(str):
    """Value in place of an answer if the helper has ended."""


def _work(jobs: "SimpleQueue[Job | None]") -> None:
    while (job := jobs.get()) is not None:
        job()


def _kill(process: "subprocess.Popen[bytes]", jobs: "SimpleQueue[Job | None]") -> None:
    process.kill()
    process.wait()
    jobs.put(None)
    # Closing writes the remaining data into a pipe that no longer has a reader.
    for stream in (process.stdin, process.stdout):
        with suppress(OSError, ValueError):
            if stream is not None:
                stream.close()
