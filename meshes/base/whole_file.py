"""Atomic writing of files, checks of output files, and versions of file formats."""

import csv
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from uuid import uuid4
from weakref import WeakSet

from meshes.base.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Owner(Protocol):
    """Owner of a folder, whose `claim` method is called before a file in the folder is written."""

    def depth(self, path: Path) -> int:
        """Return the number of components of the folder's path.

        The result is 0 if the folder does not contain ``path``.
        """
        ...

    def claim(self, path: Path) -> None:
        """Record a file of this folder, or raise an error if the file must not be replaced."""
        ...


OWNERS: "WeakSet[Owner]" = WeakSet()
"""Folders to which this process is writing."""


def claim(path: Path) -> None:
    """Report a file to the innermost folder in `OWNERS` that contains the file.

    Call this function before the file is written.
    """
    owner = max(list(OWNERS), key=lambda each: each.depth(path), default=None)
    if owner is not None and owner.depth(path):
        owner.claim(path)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path for the new content of the file `path`.

    The temporary path has the folder and the suffix of `path`. When the block ends, the temporary
    file replaces the file `path` in one step. If the block fails, the temporary file is deleted.
    Other processes therefore never read an incomplete file. If two processes write the file at the
    same time, the complete file of one of them remains. The `claim` method of a folder in `OWNERS`
    may raise an error before the block starts.
    """
    claim(path)
    # 48 random bits: two processes that write the same file use different temporary files.
    temporary = path.with_name(f".{uuid4().hex[:12]}-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)  # the caller's file name
        raise
    finally:
        with suppress(OSError):
            temporary.unlink()


@cache
def package_version() -> str:
    """Return the version of this library. Files that the library writes contain this version."""
    # import here, because it would take a tenth of the time of `tissue --help`
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
    """Check that this version of tissue can read a file's format, and return the format version.

    Parameters
    ----------
    what
        Description of the file for the user.
    held
        Version data of the file. The entry ``key`` is the format version. The entry ``tissue`` is
        the version of tissue that wrote the file.
    newest
        Newest format version that can be read.
    where
        Path of the file, used in messages.
    remedy
        Instruction for the user if the file has no version.

    Raises
    ------
    InputError
        If the format version is missing, or newer than `newest`. The message contains the format
        version of the file, `newest`, and the version of tissue that wrote the file.
    """
    stated = held.get(key)
    # Python would count True as version 1.
    if isinstance(stated, bool) or not isinstance(stated, int) or stated < 1:
        raise InputError(
            # Truncate the text, because a damaged file may contain text of any length.
            what,
            "state the version of its format as a positive whole number",
            f"{'none' if stated is None else str(stated)[:40]} in {where}",
            remedy,
        )
    if stated > newest:
        version = held.get("tissue")
        writer = "a later version of tissue" if version is None else f"tissue {str(version)[:40]}"
        raise InputError(
            what,
            f"have format {newest} or older",
            f"format {stated} in {where}, written by {writer}",
            "read it with that version of tissue",
        )
    return stated


def require_new_file(path: Path, *, overwrite: bool, name: str = "out") -> None:
    """Check that a new file can be written or that an existing regular file may be replaced.

    Parameters
    ----------
    path
        File to write.
    overwrite
        Allow a regular file to be replaced.
    name
        Name of the user's option for the file, for messages.

    Raises
    ------
    InputError
        If an existing file may not be replaced, the path is not a regular file, or the folder does
        not exist.
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
    """Return the instruction to choose another path for the output."""
    return "another --out" if name == "out" else f"another file for --{name}"


def require_place(path: Path, *, folder: bool, name: str = "out") -> None:
    """Check the name of an output and its parent folder, without changing files.

    Raises
    ------
    InputError
        If the file or folder cannot be created.
    """
    choose = f"choose {_other_output(name)}"
    text = str(path)
    try:
        text.encode("utf-8")
        is_named = "\0" not in text
    except UnicodeEncodeError:
        is_named = False
    if not is_named:
        raise InputError(
            name, "be a file name in UTF-8 without NUL characters", f"{text!r}", choose
        )
    if not folder and path.is_dir():
        raise InputError(name, "be a file", f"the folder {path}", "add the name of a file")
    place = path.absolute()
    existing = next(each for each in (place, *place.parents) if os.path.lexists(each))
    if existing.is_symlink() and not existing.exists():
        raise InputError(name, "not use a symbolic link that leads nowhere", existing, choose)
    # Replacing a file creates a new file, so the folder must be writable.
    if existing == place and not folder:
        existing = place.parent
    if not existing.is_dir():
        if existing == place:
            raise InputError(name, "be a folder", f"the file {path}", choose)
        raise InputError(name, "lie in a folder", f"{path}, but {existing} is a file", choose)
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(name, "be writable", f"permission denied at {existing}", choose)


def write_columns(path: Path, columns: "Mapping[str, ArrayLike]") -> None:
    """Write named columns of equal length as CSV, without rounding the numbers."""
    import numpy as np  # the command line imports this module and should not load NumPy

    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    write_rows(path, [columns, *rows])


def write_rows(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV. The file appears in one step, and the numbers are not rounded."""
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8. The file appears in one step."""
    with whole_file(path) as temporary:
        temporary.write_text(text, "utf-8")
