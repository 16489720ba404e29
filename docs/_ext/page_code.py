"""Code of a page of the guide: its Python, and its commands in bash blocks."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator

__all__ = ["blocks_of", "run_commands"]


def blocks_of(text: str) -> Iterator[tuple[str, str]]:
    """Language, ``python`` or ``bash``, and code of each block that is executed."""
    yield from re.findall(r"^```(python|bash)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def run_commands(code: str) -> None:
    """Run the lines of a block and raise an error if one fails.

    ``tissue`` and ``python`` run in this interpreter.
    """
    for line in code.splitlines():
        first, *words = shlex.split(line, comments=True) or [""]
        if first not in ("tissue", "python"):
            raise ValueError(
                f"a line of bash must begin with tissue or python, got {line!r}: use another fence"
            )
        subprocess.run(
            [sys.executable, *(["-m", "tissue"] if first == "tissue" else []), *words], check=True
        )
