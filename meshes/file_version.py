"""Which version of its format and of tissue a file carries, and whether this version of tissue reads it."""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from meshes.errors import InputError

__all__ = ["package_version", "require_version"]


@cache
def package_version() -> str:
    """Version of this library, which its files carry."""
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
        Name of the file as a person knows it.
    held
        What the file says of itself: its format's version under ``key``, and ``tissue``, the version that wrote it.
    newest, oldest
        Versions that are read.
    where
        The file.
    remedy
        What to do with one that is older.

    Raises
    ------
    InputError
        If the version is none, older or newer; names both versions and what wrote the file.
    """
    said = held.get(key)
    if isinstance(said, bool) or not isinstance(said, int) or said < 1:
        raise InputError(f"{what} must say the version of its format, got {str(said)[:40]} in {where}: {remedy}")
    if said > newest:
        writer = str(held.get("tissue", "a later version"))[:40]
        raise InputError(
            f"{what} must be of format {newest} or older, got {said}, written by tissue {writer}, in {where}: read it "
            "with that version of tissue"
        )
    if said < oldest:
        raise InputError(f"{what} must be of format {oldest} or newer, got {said} in {where}: {remedy}")
    return said
