"""VTK without its warning that there is no display, where a picture is drawn without one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["quiet_without_display"]


@contextmanager
def quiet_without_display() -> Iterator[None]:
    """Let VTK write errors only where no display is named: it warns of that, and then draws
    without one.
    """
    if os.environ.get("DISPLAY"):
        yield
        return
    import pyvista

    with pyvista.vtk_verbosity("error"):
        yield
