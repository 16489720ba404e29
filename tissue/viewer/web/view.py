"""A saved run in a browser: its page served by a process of its own until nobody looks any more."""

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from meshes.base.errors import InputError
from tissue.system.child import await_ready, child_command
from tissue.system.offscreen import REMEDY, drawing_environments
from tissue.system.stopping import Terminated
from tissue.viewer.window import Choice

__all__ = ["serve_view"]

MODULE = "tissue.viewer.web.view_page"
OPENS_S, CLOSES_S = 120.0, 10.0
"""How long a page may take until it is served, and to close [s]."""


def serve_view(folder: Path, choice: Choice, opened: Callable[[str], object]) -> None:
    """Serve the page of a run until it was closed for some seconds, or Ctrl-C.

    Parameters
    ----------
    folder
        Folder of the run.
    choice
        What is shown at first.
    opened
        Called with the address, which holds a random token.

    Raises
    ------
    InputError
        If nothing can be drawn or served here.
    """
    why = "this machine has no OpenGL library"
    for environment in drawing_environments():
        with TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
            child = _start(folder, choice, environment, output)
            try:
                address, problem = await_ready(child, longest_s=OPENS_S, closes_s=CLOSES_S)
                if problem is None:
                    opened(address)
                    child.wait()
                    return
                why = problem or _last_line(output) or f"its process ended with exit code {child.returncode}"
            except Terminated:
                raise
            except KeyboardInterrupt:
                return
            finally:
                child.kill()
                child.communicate()
    raise InputError(f"--web must serve a page, but {why[:200]}: {REMEDY}")


def _start(folder: Path, choice: Choice, environment: dict[str, str], output: IO[str]) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        child_command(MODULE, str(folder), json.dumps(asdict(choice))),
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=output,
        text=True,
    )


def _last_line(output: IO[str]) -> str:
    output.seek(0)
    return (output.read().strip().splitlines() or [""])[-1]
