"""Conversion of stop signals to exceptions, so that a run can end in order, and time limits."""

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

SIGHUP is sent if a terminal is closed or lost. SIGQUIT and SIGBREAK are sent by a key.
"""

AGAIN_S = 0.01
"""Delay after which a stop signal that would be lost is sent again [s].

After this delay, the callback during which Python dropped the signal has returned.
"""


CATCHES_ALL = "trimesh"
"""Package that catches every exception, also KeyboardInterrupt, around its optional imports."""


class Terminated(KeyboardInterrupt):
    """Exception in a process that received a signal of `STOPS`.

    Attributes
    ----------
    name
        Name of the signal, such as ``SIGTERM``.
    exit_code
        Exit code of a command that this signal ends: 128 plus the number of the signal.
    """

    def __init__(self, number: int = signal.SIGTERM) -> None:
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


@contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Raise `Terminated` in the main thread on a signal of `STOPS`, inside the ``with`` block.

    In other threads the block has no effect. Native code that a signal interrupts may replace the
    exception with an error of its own, for example in pydantic. After a stop, including Ctrl-C, any
    error that leaves the block is therefore replaced with the exception of the stop. Python drops
    an exception that is raised in some callbacks, such as the callback of a weak reference, and the
    package `CATCHES_ALL` would catch it. In both cases the stop signal is sent again shortly after.
    """
    received: list[KeyboardInterrupt] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if _is_caught(frame):
            threading.Timer(AGAIN_S, _send, (number,)).start()
            return
        # a shell that ends sends SIGHUP again, which would interrupt the cleanup
        if number == getattr(signal, "SIGHUP", None):
            signal.signal(number, signal.SIG_IGN)
        received.append(KeyboardInterrupt() if number == signal.SIGINT else Terminated(number))
        raise received[-1]

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
            if received:
                raise received[-1] from error
            raise
        finally:
            sys.unraisablehook = report


def end_at_once(code: int) -> NoReturn:
    """End the process after a stop, without finalising the interpreter.

    A native module whose import was interrupted may crash the interpreter during finalisation. Exit
    handlers are called and buffered output is written before the end. Threads are not waited for,
    because they may wait for work.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def interrupt_is_free() -> bool:
    """Return True if Ctrl-C raises KeyboardInterrupt.

    This is the case if the handler is Python's default handler or the handler of
    `terminated_as_exception`.
    """
    handler = signal.getsignal(signal.SIGINT)
    return handler is signal.default_int_handler or getattr(handler, "__module__", None) == __name__


@contextmanager
def signals_handled(
    numbers: tuple[int, ...], handler: Callable[[int, FrameType | None], None] | signal.Handlers
) -> Iterator[None]:
    """Call a handler for the given signals inside the ``with`` block, only in the main thread.

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
    """Return True if code of `CATCHES_ALL` is running or importing a module."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] == CATCHES_ALL:
            return True
        frame = frame.f_back
    return False


def _send(number: int) -> None:
    """Send a signal to the main thread, even while it sleeps."""
    # Windows has no `pthread_kill`, so that a sleep ends late.
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        interrupt_main(signal.Signals(number))


def returned_within(seconds: float, call: Callable[[], object]) -> bool:
    """Return True if a call returned without an error within a time [s].

    The call runs in a thread. If the call blocks, the thread is not waited for.
    """
    returned = threading.Event()

    def work() -> None:
        with suppress(Exception):
            call()
            returned.set()

    threading.Thread(target=work, daemon=True, name="may block").start()
    return returned.wait(seconds)
