"""A request of the system to end as an exception, met like Ctrl-C: files are kept, helpers end."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

__all__ = ["STOPS", "Terminated", "signals_handled", "terminated_as_exception"]

STOPS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK") if hasattr(signal, name))
"""What asks a process to end, as far as the system has it: SIGHUP comes from a terminal that was closed or lost,
SIGQUIT and SIGBREAK from a key."""


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
        self.name, self.exit_code = signal.Signals(number).name, 128 + number


@contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Raise `Terminated` in the main thread on one of `STOPS` while the block runs; elsewhere nothing changes."""
    with signals_handled(STOPS, _raise):
        yield


@contextmanager
def signals_handled(numbers: tuple[int, ...], handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Call a handler on these signals while the block runs, in the main thread alone.

    A signal that is ignored stays so, as under ``nohup``; and so does one that is handled outside Python.
    """
    before: dict[int, Any] = {}
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


def _raise(number: int, frame: FrameType | None) -> None:
    if number == getattr(signal, "SIGHUP", None):  # a shell that ends sends it once more, amid what is put in order now
        signal.signal(number, signal.SIG_IGN)
    raise Terminated(number)
