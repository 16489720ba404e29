"""What may be written where, so that nothing is lost unasked, and by one process at a time; columns as a table."""

import errno
import os
import platform
import sys
import weakref
from collections.abc import Iterable, Iterator, Mapping
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
    "prepare_folder",
    "require_new_file",
    "write_columns",
]

LOCK = ".lock"
"""Name of the lock in a folder; of a file's, the end of the hidden name next to it."""
FAR = 1 << 30
"""Byte that is locked where locked bytes cannot be read (Windows): far beyond the process id."""
SAME_S = 5.0
"""Most by which the start of one process may differ between two looks [s]: the clock behind it may be set."""
HELD = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""The system's error for a lock that another has; anything else means that the file system has no locks."""


def require_new_file(path: Path, *, overwrite: bool) -> None:
    """Refuse a file that is there, unless it may be replaced.

    Raises
    ------
    InputError
        If it is there and may not, or is a folder.
    """
    if path.is_dir():
        raise InputError(f"out must be a file, got the folder {path}: add the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"out must not exist yet, got {path}: pass --overwrite or choose another --out")


def prepare_folder(folder: Path, names: Iterable[str], what: str, *, overwrite: bool) -> None:
    """Make a folder where there is none; refuse one that holds some of these files and may not lose ``what`` they are.

    Raises
    ------
    InputError
        If it is a file, or holds one of them.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"out must be a folder, got the file {folder}: choose another --out")
    there = [name for name in names if (folder / name).exists()]
    if there and not overwrite:
        raise InputError(
            f"out must not hold another {what}, got {folder / there[0]}: pass --overwrite to replace it or choose "
            "another --out"
        )
    folder.mkdir(parents=True, exist_ok=True)


def write_columns(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length as CSV, by their names, with all digits."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    with whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")


class OutputLock:
    """Hold a folder or a file against every other writer until `release`, or until the process ends for any reason.

    Parameters
    ----------
    out
        Folder or file that is going to be written.
    folder
        Whether it is a folder, which is made where there is none; an empty one that was made so goes with the lock.

    Raises
    ------
    InputError
        If another process, or another writer in this one, holds it, or it cannot be a folder or lie in one.
    """

    def __init__(self, out: Path, *, folder: bool) -> None:
        place = (out if folder else out.parent).absolute()
        existing = next(each for each in (place, *place.parents) if each.exists())
        if not existing.is_dir():
            under = "" if existing == place else f" under the file {existing}"
            what = f"a folder, got the file {out}" if folder and not under else f"in a folder, got {out}{under}"
            raise InputError(f"out must {'be' if folder and not under else 'lie'} {what}: choose another --out")
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
        file = path.open("a+", encoding="utf-8")
        if not _lock(file):
            file.seek(0)
            owner = file.read().strip()
            file.close()
            raise InputError(
                f"out must have one writer at a time, got {out}, which process {owner or 'of unknown number'} is "
                "writing: wait for it, end it, or choose another --out"
            )
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # its last holder took it away in between
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    return file


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
    """Take the lock's file away while nobody else can have it, then let go; folders that stayed empty go, too."""
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

    return {"id": os.getpid(), "started_s": psutil.Process().create_time(), "machine": platform.node()}


def is_alive(process: object) -> bool:
    """Whether a process of that `identity` still runs; one of another machine cannot be looked up, so counts."""
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
