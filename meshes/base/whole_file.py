"""Atomic writing of files, which are complete or absent, and the versions that they state."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol
from uuid import uuid4
from weakref import WeakSet

from meshes.base.errors import InputError

__all__ = ["OWNERS", "claim", "package_version", "require_version", "whole_file"]


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
    # 48 random bits: two processes that write one file have different temporary files.
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


@cache
def package_version() -> str:
    """Return the version of this library, which its files carry."""
    try:
        return version("tissue-sim")
    except PackageNotFoundError:
        return "unknown"


def require_version(
    what: str,
    held: Mapping[str, Any],
    newest: int,
    *,
    where: object,
    remedy: str,
    key: str = "format",
) -> int:
    """Return the version of a file's format if this version of tissue reads it.

    Parameters
    ----------
    what
        Name of the file for the user.
    held
        Version data of the file: its format's version under ``key``, and ``tissue``, the version
        that wrote it.
    newest
        Newest version that is read.
    where
        The file.
    remedy
        Instruction for a file without a version.

    Raises
    ------
    InputError
        If the version is missing or newer. The message names both versions and the version
        of tissue that wrote the file.
    """
    stated = held.get(key)
    # Python would count True as version 1.
    if isinstance(stated, bool) or not isinstance(stated, int) or stated < 1:
        raise InputError(
            # Cut off, because a damaged file may hold a text of any length.
            what,
            "state the version of its format",
            f"{str(stated)[:40]} in {where}",
            remedy,
        )
    if stated > newest:
        writer = str(held.get("tissue", "a later version"))[:40]
        raise InputError(
            what,
            f"be of format {newest} or older",
            f"{stated}, written by tissue {writer}, in {where}",
            "read it with that version of tissue",
        )
    return stated
