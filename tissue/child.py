"""Start another Python that finds this checkout's packages, for work that must not share a process with the ticks."""

import sys
from pathlib import Path

__all__ = ["child_command"]

START = "import sys, runpy; sys.path.append(sys.argv.pop(1)); runpy.run_module(sys.argv.pop(1), run_name='__main__')"


def child_command(module: str, *arguments: str) -> list[str]:
    """Command that runs ``python -m module arguments``; empty where this Python cannot start another one."""
    if not sys.executable:
        return []
    return [sys.executable, "-P", "-c", START, str(Path(__file__).resolve().parent.parent), module, *arguments]
