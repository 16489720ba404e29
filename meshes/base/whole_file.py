"""Atomic writing of files, checks before they are written, and the versions that they state."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from uuid import uuid4
from weakref import WeakSet

from meshes.base.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "OWNERS",
    "claim",
    "package_version",
    "require_new_file",
    "require_place",
    "require_version",
    "whole_file",
    "write_columns",
]


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
    # not loaded for `tissue --help`, of which it would take a tenth
    from importlib.metadata import PackageNotFoundError, version

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


def require_new_file(path: Path, *, overwrite: bool, name: str = "out") -> None:
    """Check that a file can be written as a new file or in place of a replaceable regular file.

    Parameters
    ----------
    path
        File to write.
    overwrite
        Allow a regular file to be replaced.
    name
        Option that names the file, for messages.

    Raises
    ------
    InputError
        If a file exists that may not be replaced, the path is not a regular file, or the folder
        does not exist.
    """
    other = _other_output(name)
    require_place(path, folder=False, name=name)
    if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
        kind = "symbolic link" if path.is_symlink() else "device or pipe"
        raise InputError(name, "be a regular file", f"the {kind} {path}", f"choose {other}")
    if path.exists() and not overwrite:
        raise InputError(name, "not exist yet", path, f"pass --overwrite or choose {other}")
    if not path.absolute().parent.is_dir():
        raise InputError(name, "lie in a folder that exists", path, f"create {path.parent}")


def _other_output(name: str) -> str:
    """Return the advice to choose another output."""
    return "another --out" if name == "out" else f"another file for --{name}"


def require_place(path: Path, *, folder: bool, name: str = "out") -> None:
    """Check the name of an output and the folder above it, without any change.

    Raises
    ------
    InputError
        If such a file or folder cannot be created there.
    """
    choose = f"choose {_other_output(name)}"
    text = str(path)
    try:
        text.encode("utf-8")
        is_named = "\0" not in text
    except UnicodeEncodeError:
        is_named = False
    if not is_named:
        raise InputError(name, "be a name in UTF-8 without NUL", f"{text!r}", choose)
    if not folder and path.is_dir():
        raise InputError(name, "be a file", f"the folder {path}", "add the name of a file")
    place = path.absolute()
    existing = next(each for each in (place, *place.parents) if os.path.lexists(each))
    if existing.is_symlink() and not existing.exists():
        raise InputError(name, "not use a symbolic link that leads nowhere", existing, choose)
    # An existing file is replaced by a new one, so its folder must be writable.
    if existing == place and not folder:
        existing = place.parent
    if not existing.is_dir():
        if existing == place:
            raise InputError(name, "be a folder", f"the file {path}", choose)
        raise InputError(name, "lie in a folder", f"{path} under the file {existing}", choose)
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(name, "be writable", f"permission denied at {existing}", choose)


def write_columns(path: Path, columns: "Mapping[str, ArrayLike]") -> None:
    """Write columns of equal length as CSV with their names, with all digits."""
    import numpy as np  # not needed by the other functions, which the command line imports

    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    with whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")
