"""Suppression of VTK's warning about a missing display."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["quiet_without_display"]


@contextmanager
def quiet_without_display() -> Iterator[None]:
    """Restrict VTK's output to errors if no display is set.

    VTK warns about a missing display, and then draws without one.
    """
    if os.environ.get("DISPLAY"):
        yield
        return
    import pyvista

    with pyvista.vtk_verbosity("error"):
        yield
