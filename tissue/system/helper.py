"""Helper process that receives messages and answers, with detection of lost helpers."""

import os
import pickle
import signal
import subprocess
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from tissue.system.background_priority import BackgroundPriority
from tissue.system.child import CHECK_S, ONE_THREAD, HangDetector, HelperLostError, child_command

__all__ = ["Helper", "HelperLostError"]

ENDS_S = 10.0
"""Longest time for a helper to end after its input was closed [s]."""
Job = Callable[[], None]


class Helper:
    """Child Python process that receives pickled messages and answers them.

    Messages go to its standard input, and answers come from its standard output. It ends with this
    process and has one thread for linear algebra. Sending never blocks, because a separate thread
    writes. The same thread also reads the awaited answer. The code that runs in between therefore
    keeps the interpreter.

    Parameters
    ----------
    module
        Module that the helper runs.
    does
        Description of its task for messages: "the process that DOES ...".

    Attributes
    ----------
    priority
        Priority of the helper relative to the ticks.
    """

    def __init__(self, module: str, *, does: str) -> None:
        pipe = subprocess.PIPE
        # An own process group keeps Ctrl-C from the helper. An own session would make its priority
        # ineffective against this process, because Linux may first share the processor among
        # sessions.
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
        """Kill the helper; a second call does nothing."""

    @property
    def number(self) -> int:
        """Process id of the helper."""
        return self._process.pid

    def send(self, message: object) -> None:
        """Send a message without waiting for its receipt."""
        data = pickle.dumps(message, protocol=5)
        stream = self._process.stdin
        assert stream is not None

        def write() -> None:
            with suppress(OSError, ValueError):  # the helper has ended; `receive` reports it
                stream.write(data)  # in one write: a part would wake the helper too early
                stream.flush()

        self._jobs.put(write)

    def receive(self, *, longest_s: float) -> Any:
        """Wait for the next answer. An error in the helper is raised here.

        Raises
        ------
        HelperLostError
            If the helper has ended, is idle too long, or works for more than ``longest_s``. The
            helper is then killed.
        """
        stream = self._process.stdout
        answers = self._answers
        assert stream is not None
        if not self.kill.alive:
            raise HelperLostError(
                f"the process that {self._does} {_how_ended(self._process.returncode)}"
            )

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
                    raise HelperLostError(f"the process that {self._does} {why}") from None
            except BaseException:
                # such as Ctrl-C: the answer would be mistaken for the answer to the next message
                self.kill()
                raise
        if isinstance(answer, _Ended):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDS_S)
            self.kill()
            raise HelperLostError(
                f"the process that {self._does} {_how_ended(self._process.returncode)}"
            )
        if isinstance(answer, BaseException):
            self.end()
            raise answer
        return answer

    def end(self) -> None:
        """Close the standard input of the helper, which ends it."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        self.kill()


def _how_ended(code: int) -> str:
    """Describe the end of a process from its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    name = next((each.name for each in signal.Signals if each == -code), f"signal {-code}")
    return f"was ended by {name}" + (" (memory may have run out)" if name == "SIGKILL" else "")


class _Ended(str):
    """Substitute for a missing answer."""


def _work(jobs: "SimpleQueue[Job | None]") -> None:
    while (job := jobs.get()) is not None:
        job()


def _kill(process: "subprocess.Popen[bytes]", jobs: "SimpleQueue[Job | None]") -> None:
    process.kill()
    process.wait()
    jobs.put(None)
    for stream in (process.stdin, process.stdout):
        with suppress(OSError, ValueError):
            if stream is not None:
                stream.close()
