"""A helper process that is sent messages and answers, and that is never waited for in vain."""

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
"""How long a helper may take to end once there is nothing more for it [s]."""
Job = Callable[[], None]


class Helper:
    """Another Python that takes pickled messages on its standard input and answers on its standard
    output.

    It ends with this process and has one thread for linear algebra. Sending never blocks: a thread
    does it, and the same thread reads while an answer is awaited, so that nothing takes the
    interpreter from what runs in between.

    Parameters
    ----------
    module
        What it runs.
    does
        What it does, for sentences: "the process that DOES ...".

    Attributes
    ----------
    priority
        Puts it behind the ticks, or lets it hurry.
    """

    def __init__(self, module: str, *, does: str) -> None:
        pipe = subprocess.PIPE
        # In a group of its own Ctrl-C does not reach it; in a session of its own its priority would
        # not count against this process, since Linux may share the processor among sessions first.
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
        """End it at once; a second call does nothing."""

    @property
    def number(self) -> int:
        """Its process id."""
        return self._process.pid

    def send(self, message: object) -> None:
        """Send a message, without waiting until it is taken."""
        data = pickle.dumps(message, protocol=5)
        stream = self._process.stdin
        assert stream is not None

        def write() -> None:
            with suppress(OSError, ValueError):  # it has ended: the next answer shows it
                stream.write(data)  # at once: in parts it wakes the other too early
                stream.flush()

        self._jobs.put(write)

    def receive(self, *, longest_s: float) -> Any:
        """Await the next answer; an error in the other process is raised here.

        Raises
        ------
        HelperLostError
            If the process has ended, does nothing any more, or works for more than ``longest_s``;
            it is ended then.
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
                # such as Ctrl-C: the answer would be taken for that to the next message
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
        """Let it end, as it does when its standard input does."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        self.kill()


def _how_ended(code: int) -> str:
    """How a process ended, by its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    name = next((each.name for each in signal.Signals if each == -code), f"signal {-code}")
    return f"was ended by {name}" + (" (memory may have run out)" if name == "SIGKILL" else "")


class _Ended(str):
    """In place of an answer that did not come."""


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
