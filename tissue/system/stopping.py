"""Conversion of stop signals to exceptions, so that a run can write its results and end."""

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

STOPS = tuple(
    getattr(signal, name)
    for name in ("SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
    if hasattr(signal, name)
)
"""Signals of this operating system that ask a process to end.

SIGHUP is sent if a terminal is closed or lost. SIGQUIT and SIGBREAK are sent by keys of a terminal.
"""

AGAIN_S = 0.01
"""Delay after which a stop signal is sent again if its exception would be lost [s].

Python drops exceptions in some callbacks. After this delay, the callback has returned.
"""


CATCHES_ALL = "trimesh"
"""Package that catches all exceptions, even KeyboardInterrupt, during its optional imports."""


class Terminated(KeyboardInterrupt):
    """Exception that is raised if the process receives one of the signals in `STOPS`.

    Attributes
    ----------
    name
        Name of the signal, such as ``SIGTERM``.
    exit_code
        Exit code for a command that the signal ends: 128 plus the number of the signal.
    """

    def __init__(self, number: int = signal.SIGTERM) -> None:
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


_received: list[KeyboardInterrupt] = []
"""Exceptions of the signals that arrived in the present blocks of `terminated_as_exception`."""


def signal_behind(error: BaseException) -> BaseException:
    """Return the exception of the stop signal that led to an error, or the error itself.

    Native code, for example in pydantic and VTK, may convert the exception of a signal to another
    error. Any error after a stop signal or Ctrl-C is therefore attributed to the signal.
    """
    return _received[-1] if _received and isinstance(error, Exception) else error


@contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Raise `Terminated` in the main thread if a signal in `STOPS` arrives in the ``with`` block.

    In threads other than the main thread, the context manager has no effect. An error that leaves
    the block is replaced by the exception of the signal, see `signal_behind`. Python drops
    exceptions in some callbacks, such as those of weak references, and the package named by
    `CATCHES_ALL` catches all exceptions. If an exception is lost, the signal is sent again shortly
    afterwards.
    """
    earlier = len(_received)

    def stop(number: int, frame: FrameType | None) -> None:
        if _is_caught(frame):
            threading.Timer(AGAIN_S, _send, (number,)).start()
            return
        # a shell that ends sends SIGHUP again, which would interrupt the cleanup
        if number == getattr(signal, "SIGHUP", None):
            signal.signal(number, signal.SIG_IGN)
        _received.append(KeyboardInterrupt() if number == signal.SIGINT else Terminated(number))
        raise _received[-1]

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        """Send a signal again if its exception was dropped by Python."""
        if isinstance(what.exc_value, KeyboardInterrupt):
            # The exception does not contain its signal, but all signals of STOPS have the same
            # effect.
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
            if (cause := signal_behind(error)) is not error:
                raise cause from error
            raise
        finally:
            del _received[earlier:]
            sys.unraisablehook = report


def end_at_once(code: int) -> NoReturn:
    """End the process after a stop signal, without finalising the interpreter.

    A native module whose import was interrupted may crash the interpreter during finalisation. Exit
    handlers are called and buffered output is written first. The function does not wait for other
    threads, because they may never end.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def interrupt_is_free() -> bool:
    """Return True if Ctrl-C raises KeyboardInterrupt.

    This is the case if the signal handler is Python's default or was set by
    `terminated_as_exception`.
    """
    handler = signal.getsignal(signal.SIGINT)
    return handler is signal.default_int_handler or getattr(handler, "__module__", None) == __name__


@contextmanager
def signals_handled(
    numbers: tuple[int, ...], handler: Callable[[int, FrameType | None], None] | signal.Handlers
) -> Iterator[None]:
    """Set a handler for signals inside the ``with`` block; do nothing outside the main thread.

    With `signal.SIG_DFL` the operating system ends the process.

    A signal that is ignored, for example under ``nohup``, stays ignored. A signal that is handled
    outside Python keeps its handler.
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


def _is_caught(frame: FrameType | None) -> bool:
    """Return True if the package `CATCHES_ALL` is on the call stack of a frame."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] == CATCHES_ALL:
            return True
        frame = frame.f_back
    return False


def _send(number: int) -> None:
    """Send a signal to the main thread, and interrupt its sleep."""
    # Windows has no `pthread_kill`, so that a sleep ends late.
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        interrupt_main(signal.Signals(number))


def returned_within(seconds: float, call: Callable[[], object]) -> bool:
    """Run a function; return True if it returns without an error within the given time [s].

    The function runs in a thread, which is abandoned if the function takes longer.
    """
    returned = threading.Event()

    def work() -> None:
        with suppress(Exception):
            call()
            returned.set()

    threading.Thread(target=work, daemon=True, name="may block").start()
    return returned.wait(seconds)
