"""Draw in 3D without a display, in a process of its own: VTK ends the process where a graphics library is missing."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable, Iterator

from tissue.child import child_command

__all__ = ["REMEDY", "display_problem", "draw_apart"]

REMEDY = "install libegl1 and libgl1-mesa-dri (Debian, Ubuntu) or mesa-libEGL and mesa-dri-drivers (Fedora)"
"""What gives a bare Linux machine OpenGL in software."""
LONGEST_S = 120.0


def draw_apart(
    module: str, *arguments: str, prepare: Callable[[], None] | None = None, longest_s: float = LONGEST_S
) -> str | None:
    """Run ``python -m module arguments`` where it may draw, and say in half a sentence why it could not.

    Parameters
    ----------
    module, arguments
        What to run. It finds a line on its standard input once ``prepare`` is done.
    prepare
        Called once while the process starts, to make what it is going to read.
    longest_s
        How long it may draw [s].

    Returns
    -------
    None if it ended well, else the reason and the remedy.
    """
    command = child_command(module, *arguments)
    if not command:
        return "this Python cannot start another one to draw in 3D: run it from the command line"
    reason = "this machine has no OpenGL library"
    for window in _windows():
        environment = os.environ | ({"VTK_DEFAULT_OPENGL_WINDOW": window} if window else {})
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, env=environment, stdin=pipe, stdout=subprocess.DEVNULL, stderr=pipe, text=True, errors="replace"
        ) as process:
            try:
                if prepare is not None:
                    prepare()
                    prepare = None
                _, said = process.communicate("ready\n", timeout=longest_s)
            except subprocess.TimeoutExpired:
                process.kill()
                reason = f"drawing in 3D took longer than {longest_s:g} s"
                continue
            except BaseException:
                process.kill()
                raise
        if process.returncode == 0:
            return None
        reason = f"OpenGL does not work on this machine (exit code {process.returncode})"
        if process.returncode == 1 and "Error" in said:
            reason = f"drawing in 3D failed ({said.strip().splitlines()[-1][:200]})"
    return f"{reason}: {REMEDY}" if sys.platform.startswith("linux") else f"{reason}: update the graphics driver"


def display_problem() -> str | None:
    """Why no window can be opened here, or None; asks before VTK does, which would end the process."""
    if not sys.platform.startswith("linux"):
        return None
    name = os.environ.get("DISPLAY", "")
    if not name:
        return "there is no display (DISPLAY is not set)"
    library = _library("libX11.so.6")
    if library is None:
        return "libX11 is missing (install libx11-6, libgl1 and libxcursor1)"
    library.XOpenDisplay.restype = ctypes.c_void_p
    display = library.XOpenDisplay(name.encode())
    if not display:
        return f"the display {name} does not answer"
    library.XCloseDisplay.argtypes = [ctypes.c_void_p]
    library.XCloseDisplay(display)
    if _library("libGL.so.1") is None:
        return "libGL is missing (install libgl1)"
    return None


def _windows() -> Iterator[str]:
    """Kinds of VTK window to try, by class name; empty is VTK's own choice."""
    if not sys.platform.startswith("linux") or "VTK_DEFAULT_OPENGL_WINDOW" in os.environ:
        yield ""
        return
    if _library("libEGL.so.1") is not None:
        yield "vtkEGLRenderWindow"
    if any(_library(f"libOSMesa.so.{version}") is not None for version in (8, 6)):
        yield "vtkOSOpenGLRenderWindow"
    if display_problem() is None:
        yield "vtkXOpenGLRenderWindow"


def _library(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None
