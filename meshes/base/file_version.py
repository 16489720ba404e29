"""Version of a file's format and of tissue, and the check whether this tissue reads it."""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from meshes.base.errors import InputError

__all__ = ["package_version", "require_version"]


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
    oldest: int = 1,
) -> int:
    """Return the version of a file's format if this version of tissue reads it.

    Parameters
    ----------
    what
        Name of the file for the user.
    held
        Version data of the file: its format's version under ``key``, and ``tissue``, the version
        that wrote it.
    newest, oldest
        Versions that are read.
    where
        The file.
    remedy
        Instruction for a file that is older.

    Raises
    ------
    InputError
        If the version is missing, older or newer. The message names both versions and the version
        of tissue that wrote the file.
    """
    stated = held.get(key)
    if isinstance(stated, bool) or not isinstance(stated, int) or stated < 1:
        raise InputError(
            what, "state the version of its format", f"{str(stated)[:40]} in {where}", remedy
        )
    if stated > newest:
        writer = str(held.get("tissue", "a later version"))[:40]
        raise InputError(
            what,
            f"be of format {newest} or older",
            f"{stated}, written by tissue {writer}, in {where}",
            "read it with that version of tissue",
        )
    if stated < oldest:
        raise InputError(what, f"be of format {oldest} or newer", f"{stated} in {where}", remedy)
    return stated
