"""Standard streams and working directory as a command finds them."""

import os
import sys
from typing import NoReturn

__all__ = ["has_working_folder", "leave_pipe", "open_streams"]

PIPE_CLOSED = 141
"""Exit code of a command whose reader has ended: 128 and the number of SIGPIPE."""


def open_streams() -> None:
    """Replace standard streams that are closed, and print characters that a stream cannot encode by their codes.

    A descriptor that is closed would be given to the next file that is opened, and libraries that print to it would
    write into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def has_working_folder() -> bool:
    """Return whether the working directory is there."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def leave_pipe() -> NoReturn:
    """End a command whose output nobody reads any more."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)  # what is still buffered goes nowhere
    sys.exit(PIPE_CLOSED)
