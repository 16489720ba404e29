"""Child Python process that runs a function of this checkout and ends with its parent."""

import sys
from pathlib import Path

__all__ = ["kill_with_parent", "python_command", "start_code"]

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of Linux."""


def start_code(module: str, function: str) -> str:
    """Return code that calls a function of this checkout.

    The function finds its arguments in `sys.argv[1:]`.
    """
    return (
        f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import {function}; "
        f"{function}()"
    )


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs `start_code` in another Python; empty if none can be started."""
    if not sys.executable:
        return []
    return [sys.executable, "-P", "-c", code, str(Path(__file__).resolve().parents[2]), *arguments]


def kill_with_parent() -> None:
    """Make the system kill this process when the thread that started it ends.

    This works on Linux only.
    """
    if sys.platform.startswith("linux"):
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
