"""Checks of output files, locks against a second writer, and tables of columns."""

import errno
import os
import platform
import sys
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

__all__ = [
    "LOCK",
    "OutputLock",
    "identity",
    "is_alive",
    "output_locked",
    "require_new_file",
    "require_place",
    "write_columns",
]

LOCK = ".lock"
"""Name of the lock of a folder, and suffix of the hidden lock next to an output file."""
FAR = 1 << 30
"""Locked byte on Windows, where locked bytes cannot be read; far behind the process id."""
LONGEST_LOCK = 32
"""Longest content of a lock [characters]: a process id and the end of its line."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of the system that refuses to open a symbolic link."""
SAME_S = 5.0
"""Largest difference between two readings of the start time of one process [s].

The system clock may be set in between. Ids are given out in turn, so that another process rarely
gets the same id within so short a time.
"""
HELD = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""Error codes of a lock held by another process; other codes mean that locks are not supported."""


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
    other = _other(name)
    require_place(path, folder=False, name=name)
    if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
        kind = "symbolic link" if path.is_symlink() else "device or pipe"
        raise InputError(name, "be a regular file", f"the {kind} {path}", f"choose {other}")
    if path.exists() and not overwrite:
        raise InputError(name, "not exist yet", path, f"pass --overwrite or choose {other}")
    if not path.absolute().parent.is_dir():
        raise InputError(name, "lie in a folder that exists", path, f"create {path.parent}")


def _other(name: str) -> str:
    """Return the advice to choose another output."""
    return "another --out" if name == "out" else f"another file for --{name}"


def require_place(path: Path, *, folder: bool, name: str = "out") -> None:
    """Check the name of an output and the folder above it, without any change.

    Raises
    ------
    InputError
        If such a file or folder cannot be created there.
    """
    choose = f"choose {_other(name)}"
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


class OutputLock:
    """Exclusive lock on an output folder or file, until `release` or the end of the process.

    Parameters
    ----------
    out
        Output folder or file.
    folder
        True for a folder. A missing folder is created. If it stays empty, it is removed with the
        lock.

    Raises
    ------
    InputError
        If another process, or another writer in this process, holds the lock, or the folder cannot
        be created.
    """

    def __init__(self, out: Path, *, folder: bool) -> None:
        require_place(out, folder=folder)
        place = (out if folder else out.parent).absolute()
        made = [each for each in (place, *place.parents) if not each.exists()]
        place.mkdir(parents=True, exist_ok=True)
        path = place / (LOCK if folder else f".{out.name}{LOCK}")
        self.release = weakref.finalize(self, _let_go, _taken(path, out), path, made)
        """Release the lock; a second call does nothing."""


@contextmanager
def output_locked(out: Path, *, folder: bool) -> Iterator[None]:
    """Lock an output while the block runs; see `OutputLock`."""
    lock = OutputLock(out, folder=folder)
    try:
        yield
    finally:
        lock.release()


def _taken(path: Path, out: Path) -> TextIO:
    """Return the locked lock file, with the id of this process in it."""
    while True:
        file = _opened(path)
        if not _lock(file):
            file.seek(0)
            owner = file.read().strip()
            file.close()
            raise InputError(
                "out",
                "have one writer at a time",
                f"{out}, which process {owner or 'of unknown number'} is writing",
                "wait for it, end it, or choose another --out",
            )
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # The previous holder removed it in between: a lock on it guards nothing.
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    return file


def _opened(path: Path) -> TextIO:
    """Open the lock file, and refuse a file of the user with the same name."""
    plain = not path.is_symlink() and (path.is_file() or not path.exists())
    if plain:
        file = os.fdopen(
            # 0o666: the user's umask decides about the permissions.
            os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | NO_LINK, 0o666),
            "a+",
            encoding="utf-8",
        )
        if _is_lock(file):
            return file
        file.close()
    raise InputError(
        "out",
        f"hold no file {path.name} of other origin",
        f"one in {path.parent}",
        "move it or choose another --out",
    )


def _is_lock(file: TextIO) -> bool:
    """Return whether a file is empty or contains only a process id, as a lock file does."""
    try:
        file.seek(0)
        held = file.read(LONGEST_LOCK + 1)
    except UnicodeDecodeError:
        return False
    except OSError:  # locked bytes cannot be read on Windows: another writer holds the lock
        return True
    return not held or (held.strip().isdecimal() and len(held) <= LONGEST_LOCK)


def _lock(file: TextIO) -> bool:
    """Lock an open file, and return whether it succeeded or the file system has no locks."""
    try:
        if sys.platform == "win32":
            os.lseek(file.fileno(), FAR, os.SEEK_SET)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in HELD
    return True


def _let_go(file: TextIO, path: Path, made: list[Path]) -> None:
    """Remove and release the lock file, and remove the created folders that stayed empty.

    The file is removed while no other process can lock it.
    """
    if sys.platform == "win32":
        file.close()  # Windows cannot remove an open file, of this or another process
    with suppress(OSError):
        path.unlink()
    with suppress(OSError):
        file.close()
    for each in made:
        with suppress(OSError):
            each.rmdir()


def identity() -> dict[str, int | float | str]:
    """Return the id and start time [s since 1970] of this process, and its machine."""
    import psutil

    return {
        "id": os.getpid(),
        "started_s": psutil.Process().create_time(),
        "machine": platform.node(),
    }


def is_alive(process: object) -> bool:
    """Return whether the process of an `identity` still runs.

    A process of another machine cannot be checked and counts as running.
    """
    import psutil

    if not isinstance(process, dict) or "id" not in process:
        return False
    if process.get("machine") != platform.node():
        return True
    try:
        found = psutil.Process(int(process["id"]))
        same = abs(found.create_time() - float(process["started_s"])) < SAME_S
        return same and found.status() != psutil.STATUS_ZOMBIE
    except (psutil.NoSuchProcess, KeyError, TypeError, ValueError):
        return False
    except psutil.AccessDenied:
        return True
