"""Calls with a time limit."""

import threading
from collections.abc import Callable
from contextlib import suppress

__all__ = ["returned_within"]


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
