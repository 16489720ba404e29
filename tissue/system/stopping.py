"""Stop signals as an exception, so that files are kept and helpers end, and time limits."""

import atexit
import os
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

__all__ = [
    "STOPS",
    "Terminated",
    "end_at_once",
    "interrupt_is_free",
    "returned_within",
    "signals_handled",
    "terminated_as_exception",
]

STOPS = tuple(
    getattr(signal, name)
    for name in ("SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
    if hasattr(signal, name)
)
"""Signals that ask a process to end, where the system has them.

SIGHUP comes from a closed or lost terminal, SIGQUIT and SIGBREAK from a key.
"""

AGAIN_S = 0.01
"""Delay before a stop signal that Python dropped is sent again [s].

The callback that dropped it has returned by then.
"""


class Terminated(KeyboardInterrupt):
    """Exception for a process that a signal of `STOPS` asked to end.

    Attributes
    ----------
    name
        Name of the signal, such as ``SIGTERM``.
    exit_code
        Exit code of a command that this signal ended: 128 plus the number of the signal.
    """

    def __init__(self, number: int = signal.SIGTERM) -> None:
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


@contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Raise `Terminated` in the main thread on one of `STOPS` while the block runs.

    Outside the main thread, nothing changes. Native code interrupted by a signal may replace the
    raised exception by an error of its own, as pydantic does. After a stop, including Ctrl-C, any
    error that leaves the block is therefore replaced by the stop. Python drops an exception raised
    in a callback, such as the callback of a weak reference. The stop signal is then sent again a
    moment later.
    """
    received: list[KeyboardInterrupt] = []

    def stop(number: int, frame: FrameType | None) -> None:
        # an ending shell sends SIGHUP again, which would interrupt the cleanup
        if number == getattr(signal, "SIGHUP", None):
            signal.signal(number, signal.SIG_IGN)
        received.append(KeyboardInterrupt() if number == signal.SIGINT else Terminated(number))
        raise received[-1]

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        """Send a signal again if its exception was raised where it could not be caught."""
        if isinstance(what.exc_value, KeyboardInterrupt):
            # The exception does not hold its signal. All signals of STOPS end the program alike.
            number = signal.SIGTERM if isinstance(what.exc_value, Terminated) else signal.SIGINT
            threading.Timer(AGAIN_S, _send, (number,)).start()
        else:
            report(what)

    taken = (*STOPS, signal.SIGINT) if interrupt_is_free() else STOPS
    report = sys.unraisablehook
    sys.unraisablehook = dropped
    with signals_handled(taken, stop):
        try:
            yield
        except KeyboardInterrupt:
            raise
        except Exception as error:
            if received:
                raise received[-1] from error
            raise
        finally:
            sys.unraisablehook = report


def end_at_once(code: int) -> NoReturn:
    """End the process after a stop, without taking down the interpreter.

    A native module whose import was interrupted may crash the interpreter while it is taken down.
    Exit handlers and buffered output come first. Threads, which may wait for work, are left.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def interrupt_is_free() -> bool:
    """Return whether Ctrl-C raises KeyboardInterrupt.

    The handler is Python's default or the one of `terminated_as_exception`.
    """
    handler = signal.getsignal(signal.SIGINT)
    return handler is signal.default_int_handler or getattr(handler, "__module__", None) == __name__


@contextmanager
def signals_handled(
    numbers: tuple[int, ...], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Handle these signals while the block runs, in the main thread only.

    A signal that is ignored, as under ``nohup``, stays ignored. A signal handled outside Python
    keeps its handler.
    """
    before: dict[int, Callable[[int, FrameType | None], object] | int] = {}
    if threading.current_thread() is threading.main_thread():
        found = {number: signal.getsignal(number) for number in numbers}
        before = {number: old for number, old in found.items() if old not in (signal.SIG_IGN, None)}
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _send(number: int) -> None:
    """Send a signal to the main thread, even while it sleeps."""
    # Windows has no `pthread_kill`; there a sleep ends late.
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        interrupt_main(signal.Signals(number))


def returned_within(seconds: float, call: Callable[[], object]) -> bool:
    """Return whether a call returned within a time [s] and without an error.

    The call runs in a thread, which is abandoned if it blocks.
    """
    returned = threading.Event()

    def work() -> None:
        with suppress(Exception):
            call()
            returned.set()

    threading.Thread(target=work, daemon=True, name="may block").start()
    return returned.wait(seconds)
