"""Atomic writing of files: a file is complete or absent."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol
from uuid import uuid4
from weakref import WeakSet

__all__ = ["OWNERS", "claim", "whole_file"]


class Owner(Protocol):
    """A folder whose files are claimed before they are written."""

    def depth(self, path: Path) -> int:
        """Return the number of parts in the folder's path if it holds ``path``, else 0."""
        ...

    def claim(self, path: Path) -> None:
        """Refuse a file that must not be replaced, or take note of it."""
        ...


OWNERS: "WeakSet[Owner]" = WeakSet()
"""Folders that are being written by this process."""


def claim(path: Path) -> None:
    """Announce a file before it is written to the innermost folder in `OWNERS` that holds it."""
    owner = max(list(OWNERS), key=lambda each: each.depth(path), default=None)
    if owner is not None and owner.depth(path):
        owner.claim(path)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name in a file's folder, of the same ending, to write to in the block.

    The written content replaces the file in one step when the block ends, and is deleted when it
    fails; so no reader sees half of it, and of two writers one wins. A folder in `OWNERS` that
    holds the file may refuse it.
    """
    claim(path)
    temporary = path.with_name(f".{uuid4().hex[:12]}-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)  # the name that the caller knows
        raise
    finally:
        with suppress(OSError):
            temporary.unlink()
