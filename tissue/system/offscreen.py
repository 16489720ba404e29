"""Offscreen 3D drawing in a separate process.

If a graphics library is missing, VTK ends the process. A separate process keeps this process alive.
"""

import ctypes
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import IO

from meshes.base.errors import InputError
from tissue.system.child import CHECK_S, HangDetector, child_command
from tissue.system.stopping import returned_within

REMEDY = (
    "install libegl1 and libgl1-mesa-dri (Debian, Ubuntu) or mesa-libEGL and mesa-dri-drivers "
    "(Fedora)"
)
"""Advice in messages: packages with software OpenGL for Linux without graphics drivers."""
LONGEST_S = 120.0
"""Longest time for drawing a picture [s]; pictures of the largest scenes take some seconds."""
DISPLAY_S = 30.0
ANSWERS_S = 5.0
"""Longest wait for the answer of a display in one attempt [s].

Attempts are repeated for at most `DISPLAY_S`.

A display that is starting refuses connections. A display server that was stopped accepts
connections but never answers.
"""


def draw_apart(
    module: str,
    *arguments: str,
    prepare: Callable[[], bytes] | None = None,
    longest_s: float = LONGEST_S,
    drawn: Callable[[float], None] | None = None,
) -> str | None:
    """Run ``python -m module arguments`` in a separate process that can draw 3D images.

    Parameters
    ----------
    module, arguments
        Module to run and its arguments.
    prepare
        Function that returns the data for the standard input of the process. The function is called
        once, while the process starts. The data are not passed in a file, because a killed process
        could leave a file with a patient's anatomy on disk.
    longest_s
        Longest drawing time [s].
    drawn
        Function that is called with the progress, 0 to 1. The drawing process must print its
        progress, one value per line.

    Returns
    -------
    None on success. Otherwise the reason of the failure and the remedy, as part of a sentence.

    Raises
    ------
    InputError
        If the process ended with an InputError.
    """
    command = child_command(module, *arguments)
    if not command:
        return "this Python cannot start another one to draw in 3D: run it from the command line"
    reason = "this machine has no OpenGL library"
    sent = b"ready\n"
    for changes in drawing_environments():
        environment = os.environ | changes
        pipe = subprocess.PIPE
        with (
            TemporaryDirectory(prefix="tissue-") as folder,
            (printed := Path(folder) / "printed").open("wb") as out,
            subprocess.Popen(
                command, env=environment, stdin=pipe, stdout=out, stderr=pipe
            ) as process,
        ):
            try:
                if prepare is not None:
                    sent = prepare()
                    prepare = None
                output, late = _awaited(process, sent, longest_s, drawn, printed)
            except BaseException:
                process.kill()
                raise
        if late is not None:
            reason = f"drawing in 3D {late}"
            continue
        if process.returncode == 0:
            return None
        reason = f"OpenGL does not work on this machine (exit code {process.returncode})"
        _, refused, sentence = output.rpartition(f"{InputError.__module__}.{InputError.__name__}: ")
        # Exit code 1 is a Python error. A crash in a graphics library has another exit code, and
        # the next environment is tried.
        if process.returncode == 1 and refused:
            raise InputError(" ".join(sentence.split()))
        if process.returncode == 1 and "Error" in output:
            # 200 characters keep the message on a few lines.
            reason = f"drawing in 3D failed ({output.strip().splitlines()[-1][:200]})"
    return (
        f"{reason}: {REMEDY}"
        if sys.platform.startswith("linux")
        else f"{reason}: update the graphics driver"
    )


def _last_share(printed: Path) -> float:
    """Return the progress, 0 to 1, from the last complete line that a process has printed."""
    for line in reversed(printed.read_text("utf-8", "replace").split("\n")[:-1]):
        with suppress(ValueError):
            return min(max(float(line), 0.0), 1.0)
    return 0.0


def _awaited(
    process: "subprocess.Popen[bytes]",
    sent: bytes,
    longest_s: float,
    drawn: Callable[[float], None] | None,
    printed: Path,
) -> tuple[str, str | None]:
    """Wait for a drawing process; return its error output, and the reason if it was killed.

    The reason is None if the process ended by itself. The function `drawn` is called with the
    progress during the wait.
    """
    detector = HangDetector(lambda: [process.pid], longest_s=longest_s)
    # A thread sends the data, because `communicate` drops the rest of its input after a timeout.
    stream = process.stdin
    process.stdin = None
    threading.Thread(target=_send, args=(stream, sent), daemon=True).start()
    while True:
        try:
            return process.communicate(timeout=CHECK_S)[1].decode("utf-8", "replace"), None
        except subprocess.TimeoutExpired:
            late = detector.check()
            if drawn is not None:
                drawn(_last_share(printed))
        if late is not None:
            process.kill()
            return process.communicate()[1].decode("utf-8", "replace"), late


def _send(stream: IO[bytes] | None, sent: bytes) -> None:
    """Write data to the standard input of a process; ignore the error if the process has ended."""
    assert stream is not None
    with suppress(OSError, ValueError), stream:
        stream.write(sent)


def display_problem() -> str | None:
    """Return the reason why no window can be opened, or None.

    Call this function before VTK opens a window, because VTK ends the process if it cannot open
    one.
    """
    if not sys.platform.startswith("linux"):
        return None
    name = os.environ.get("DISPLAY", "")
    if not name:
        return "there is no display (DISPLAY is not set)"
    library = _library("libX11.so.6")
    if library is None:
        return "libX11 is missing (install libx11-6, libgl1 and libxcursor1)"
    if not _answers(library, name):
        return f"the display {name} does not answer"
    if _library("libGL.so.1") is None:
        return "libGL is missing (install libgl1)"
    return None


def await_display() -> str | None:
    """Wait until the display responds, then return the result of `display_problem`.

    Raises
    ------
    InputError
        If the display does not answer in time.
    """
    until = monotonic() + DISPLAY_S
    while (problem := display_problem()) is not None and problem.endswith("does not answer"):
        if monotonic() >= until:
            raise InputError(
                "DISPLAY",
                "name a display that answers",
                f"{os.environ['DISPLAY']}, which gave no answer within {DISPLAY_S:g} s",
                "start this display, or unset DISPLAY to run without a window",
            )
        # The interval is short compared with the seconds that a display takes to start.
        sleep(0.2)
    return problem


def _answers(library: ctypes.CDLL, name: str) -> bool:
    """Return True if the display with a name can be opened.

    The call blocks if the display accepts the connection and never answers.
    """
    library.XOpenDisplay.restype = ctypes.c_void_p
    library.XCloseDisplay.argtypes = [ctypes.c_void_p]

    def ask() -> None:
        """Open and close the display; raise an error if it cannot be opened."""
        display = library.XOpenDisplay(name.encode())
        if not display:
            raise OSError(name)
        library.XCloseDisplay(display)

    return returned_within(ANSWERS_S, ask)


def drawing_environments() -> Iterator[dict[str, str]]:
    """Yield the sets of environment variables to try, one after another, for a drawing process.

    The variables select the class of VTK's render window.
    """
    key = "VTK_DEFAULT_OPENGL_WINDOW"
    # Other operating systems draw without a display. If the user has chosen a class, only this
    # class is tried.
    if not sys.platform.startswith("linux") or key in os.environ:
        yield {}
        return
    # EGL is first, because it can use the graphics card. A window on a display may be visible.
    if _library("libEGL.so.1") is not None:
        yield {key: "vtkEGLRenderWindow"}
    # Major versions of the library: 8 in current Mesa, 6 in older versions.
    if any(_library(f"libOSMesa.so.{version}") is not None for version in (8, 6)):
        yield {key: "vtkOSOpenGLRenderWindow"}
    if display_problem() is None:
        yield {key: "vtkXOpenGLRenderWindow"}


def _library(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


@contextmanager
def quiet_without_display() -> Iterator[None]:
    """Restrict VTK's output to errors if no display is set.

    Without this, VTK would warn about the missing display, although it can draw without one.
    """
    if os.environ.get("DISPLAY"):
        yield
        return
    import pyvista

    with pyvista.vtk_verbosity("error"):
        yield
