"""A process that draws for a page and serves it: what it takes from the others, and what it prints."""

import asyncio
import os
import signal
from collections.abc import Callable

from tissue.viewer.web.server import PageServer, Session

__all__ = ["serve"]

NICE = 5
"""Lower priority beside ticks."""


def serve(make: Callable[[], Session], *, beside_ticks: bool) -> None:
    """Make what is shown and serve it until it is over; its address is printed behind the word ready.

    Whoever has started the process decides when it ends, so that Ctrl-C does nothing here.

    Parameters
    ----------
    make
        Makes what is shown.
    beside_ticks
        Whether ticks go on beside it, which come first.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if beside_ticks:
        if hasattr(os, "nice"):
            os.nice(NICE)
        os.environ.setdefault("LP_NUM_THREADS", "1")  # OpenGL in software would take every core from the ticks
    standard_output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    import pyvista

    pyvista.global_theme.multi_samples = 1  # drawn in software, smooth edges take three times as long
    session = make()
    server = PageServer(session)
    asyncio.run(server.serve(lambda address: print(f"ready {address}", file=standard_output, flush=True)))
