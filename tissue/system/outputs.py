"""Checks of output files, locks against a second writer, and tables of columns."""

import errno
import os
import platform
import sys
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file

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
"""Name of the lock in a folder; of a file's, the end of the hidden name next to it."""
FAR = 1 << 30
"""Byte that is locked where locked bytes cannot be read (Windows): far beyond the process id."""
LONGEST_LOCK = 32
"""Longest content of a lock [characters]: the number of a process and the end of its line."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of the system that opens no symbolic link."""
SAME_S = 5.0
"""Most by which the start of one process may differ between two looks [s]: the clock behind it
may be set.
"""
HELD = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""The system's error for a lock that another has; anything else means that the file system has
no locks.
"""


def require_new_file(path: Path, *, overwrite: bool, name: str = "out") -> None:
    """Check that a file can be written where none is, or in place of a regular file that may be
    replaced.

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
        If there is a file that may not be replaced, something else that is no regular file, or no
        folder to write to.
    """
    other = "another --out" if name == "out" else f"another file for --{name}"
    require_place(path, folder=False, name=name)
    if path.is_symlink():
        raise InputError(name, "be a regular file", f"the symbolic link {path}", f"choose {other}")
    if path.exists() and not path.is_file():
        raise InputError(name, "be a regular file", f"the device or pipe {path}", f"choose {other}")
    if path.exists() and not overwrite:
        raise InputError(name, "not exist yet", path, f"pass --overwrite or choose {other}")
    if not path.absolute().parent.is_dir():
        raise InputError(name, "lie in a folder that exists", path, f"create {path.parent}")


def require_place(path: Path, *, folder: bool, name: str = "out") -> None:
    """Check the name of an output and the folder above it, and change nothing.

    Raises
    ------
    InputError
        If no such file or folder can be made there.
    """
    other = "another --out" if name == "out" else f"another file for --{name}"
    text = str(path)
    if "\0" in text:
        raise InputError(name, "be a name without NUL", f"{text!r}", f"choose {other}")
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(name, "be a name in UTF-8", f"{text!r}", f"choose {other}") from None
    if not folder and path.is_dir():
        raise InputError(name, "be a file", f"the folder {path}", "add the name of a file")
    place = path.absolute()
    existing = next(each for each in (place, *place.parents) if os.path.lexists(each))
    if existing.is_symlink() and not existing.exists():
        raise InputError(
            name, "not use a symbolic link that leads nowhere", existing, f"choose {other}"
        )
    if existing == place and not folder:
        existing = place.parent
    if not existing.is_dir() and existing == place:
        raise InputError(name, "be a folder", f"the file {path}", f"choose {other}")
    if not existing.is_dir():
        raise InputError(
            name, "lie in a folder", f"{path} under the file {existing}", f"choose {other}"
        )
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(name, "be writable", f"permission denied at {existing}", f"choose {other}")


def write_columns(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length as CSV, by their names, with all digits."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    with whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")


class OutputLock:
    """Hold a folder or a file against every other writer until `release`, or until the process ends
    for any reason.

    Parameters
    ----------
    out
        Folder or file that is going to be written.
    folder
        Whether it is a folder, which is made where there is none; an empty one that was made so
        goes with the lock.

    Raises
    ------
    InputError
        If another process, or another writer in this one, holds it, or it cannot be a folder or lie
        in one.
    """

    def __init__(self, out: Path, *, folder: bool) -> None:
        require_place(out, folder=folder)
        place = (out if folder else out.parent).absolute()
        made = [each for each in (place, *place.parents) if not each.exists()]
        place.mkdir(parents=True, exist_ok=True)
        path = place / (LOCK if folder else f".{out.name}{LOCK}")
        self.release = weakref.finalize(self, _let_go, _taken(path, out), path, made)
        """Let go of it; a second call does nothing."""


@contextmanager
def output_locked(out: Path, *, folder: bool) -> Iterator[None]:
    """Hold an output while the block runs; see `OutputLock`."""
    lock = OutputLock(out, folder=folder)
    try:
        yield
    finally:
        lock.release()


def _taken(path: Path, out: Path) -> TextIO:
    """The lock's file, locked, with this process's id in it."""
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
        file.close()  # its last holder took it away in between
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    return file


def _opened(path: Path) -> TextIO:
    """Open the lock's file, and refuse a file of the user that has its name."""
    plain = not path.is_symlink() and (path.is_file() or not path.exists())
    if plain:
        file = os.fdopen(
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
    """Return whether a file holds the number of a process or nothing, as a lock's file does."""
    try:
        file.seek(0)
        held = file.read(LONGEST_LOCK + 1)
    except UnicodeDecodeError:
        return False
    except OSError:  # locked bytes cannot be read on Windows: another writer holds it
        return True
    return not held or (held.strip().isdecimal() and len(held) <= LONGEST_LOCK)


def _lock(file: TextIO) -> bool:
    """Lock an open file if nobody else has; a file system without locks lets everybody."""
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
    """Take the lock's file away while nobody else can have it, then let go; folders that stayed
    empty go, too.
    """
    if sys.platform == "win32":
        file.close()  # an open file cannot be taken away there, another's neither
    with suppress(OSError):
        path.unlink()
    with suppress(OSError):
        file.close()
    for each in made:
        with suppress(OSError):
            each.rmdir()


def identity() -> dict[str, int | float | str]:
    """Number and start [s since 1970] of this process, and the machine it runs on."""
    import psutil

    return {
        "id": os.getpid(),
        "started_s": psutil.Process().create_time(),
        "machine": platform.node(),
    }


def is_alive(process: object) -> bool:
    """Whether a process of that `identity` still runs; one of another machine cannot be looked
    up, so counts.
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
