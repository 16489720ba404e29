"""A request of the system to end as an exception, met like Ctrl-C: files are kept, helpers end."""

import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["STOPS", "Terminated", "interrupt_is_free", "signals_handled", "terminated_as_exception"]

STOPS = tuple(
    getattr(signal, name)
    for name in ("SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
    if hasattr(signal, name)
)
"""What asks a process to end, as far as the system has it: SIGHUP comes from a terminal that was
closed or lost, SIGQUIT and SIGBREAK from a key."""

AGAIN_S = 0.01
"""When a stop that Python dropped comes once more [s]."""


class Terminated(KeyboardInterrupt):
    """The process was asked to end by a signal, one of `STOPS`.

    Attributes
    ----------
    name
        Of the signal, such as ``SIGTERM``.
    exit_code
        With which a command ends that was asked so: 128 and the signal's number.
    """

    def __init__(self, number: int = signal.SIGTERM) -> None:
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


@contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Raise `Terminated` in the main thread on one of `STOPS` while the block runs; elsewhere
    nothing changes.

    Native code that a signal meets may make an error of its own of what is raised, as pydantic's
    does: after a stop, Ctrl-C included, any error that leaves the block leaves it as that stop. And
    Python drops what is raised within a callback, such as that of a weak reference: the stop then
    comes once more, a moment later.
    """
    received: list[KeyboardInterrupt] = []

    def stop(number: int, frame: FrameType | None) -> None:
        # a shell that ends sends it again, amid what is put in order
        if number == getattr(signal, "SIGHUP", None):
            signal.signal(number, signal.SIG_IGN)
        received.append(KeyboardInterrupt() if number == signal.SIGINT else Terminated(number))
        raise received[-1]

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        """Send again a signal whose exception was raised where nothing could catch it."""
        if isinstance(what.exc_value, KeyboardInterrupt):
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


def interrupt_is_free() -> bool:
    """Whether Ctrl-C raises KeyboardInterrupt, by Python's own handler or by
    `terminated_as_exception`.
    """
    handler = signal.getsignal(signal.SIGINT)
    return handler is signal.default_int_handler or getattr(handler, "__module__", None) == __name__


@contextmanager
def signals_handled(
    numbers: tuple[int, ...], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Call a handler on these signals while the block runs, in the main thread alone.

    A signal that is ignored stays so, as under ``nohup``; and so does one that is handled outside
    Python.
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
    """Send a signal to the main thread, awake or asleep."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        interrupt_main(signal.Signals(number))
