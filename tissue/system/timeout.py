"""Calls that may block, given up after a time."""

import threading
from collections.abc import Callable
from contextlib import suppress

__all__ = ["returned_within"]


def returned_within(seconds: float, call: Callable[[], object]) -> bool:
    """Whether a call, made in a thread of its own that is left behind if it blocks, returned in
    time without error.
    """
    returned = threading.Event()

    def work() -> None:
        with suppress(Exception):
            call()
            returned.set()

    threading.Thread(target=work, daemon=True, name="may block").start()
    return returned.wait(seconds)
