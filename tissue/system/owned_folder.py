"""Output folders in which a command never replaces or removes files of the user.

A lock keeps two processes from writing to the same output folder or file.
"""

import errno
import json
import os
import platform
import sys
import threading
import weakref
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Self, TextIO

from meshes.base.errors import InputError
from meshes.base.text_tables import read_json
from meshes.base.whole_file import OWNERS, package_version, require_place, write_text

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

MARKER = ".tissue.json"
"""Name of the marker file, which lists the files that tissue wrote into a folder."""
FORMAT = "tissue output folder"
VERSION = 1
"""Version of the format of the marker file."""
LONGEST_MARKER = 1 << 24
"""Largest marker file that is read [bytes]; with 40,000 names, the file has 2 MB."""

LOCK = ".lock"
"""Name of the lock file in a folder, and suffix of the hidden lock file of an output file."""
FAR = 1 << 30
"""Position of the locked byte in a lock file on Windows.

On Windows, a locked byte cannot be read. The byte is therefore far behind the process id in the
file.
"""
LONGEST_LOCK = 32
"""Longest content of a lock file [characters]: a process id and a line end."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of ``os.open`` that refuses symbolic links."""
SAME_S = 5.0
"""Tolerance for the start time of a process when its id and start time are checked [s].

The tolerance allows for a change of the system clock. Process ids are assigned in order, so another
process rarely gets the same id within this time.
"""
HELD = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""Error codes of a failed lock if another process holds the lock.

Other error codes mean that the file system does not support locks.
"""
_claimed: set[Path] = set()
"""Folders in which this process has listed a file in the marker file."""
Files = dict[str, set[str]]
"""Names of files, relative to their folder, keyed by kind of output."""


class OwnedFolder:
    """Output folder that a command locks and fills with files.

    Each file is listed in the marker file before it is written. Only listed files are replaced or
    removed. While the folder is locked, `whole_file` calls `claim` before it writes a file. `claim`
    raises an error for an existing file that tissue did not write.

    Parameters
    ----------
    path
        Path of the folder.
    kind
        Kind of output, such as ``run``. It is written to the marker file and used in messages.
    names
        Names of the files that may be written: paths relative to the folder, with wildcards as in
        `Path.glob`.
    overwrite
        True to remove the files of an earlier output of this kind.
    shared
        Names of files that are replaced even without `overwrite`.

    Raises
    ------
    InputError
        If the folder holds another kind of output, if it holds files with these names that tissue
        did not write, or if another process writes to it.
    """

    def __init__(
        self,
        path: Path,
        kind: str,
        names: Iterable[str],
        *,
        overwrite: bool = False,
        shared: Iterable[str] = (),
    ) -> None:
        self._kind = kind
        self._path = path
        self._place = Path(os.path.abspath(path))
        self._files: Files = {}
        self._writing = threading.Lock()
        self._check = partial(
            require_folder,
            path,
            kind,
            tuple(names),
            overwrite=overwrite,
            shared=tuple(shared),
        )
        self._check()
        self._lock = OutputLock(path, folder=True)

    def begin(self) -> None:
        """Remove the files of an earlier output, and write the marker file."""
        replaced = self._check()  # another process may have written files since the first check
        self._files = listed_files(self._path)
        listed = self._files.setdefault(self._kind, set())
        self._write_marker()
        for name in sorted(replaced, reverse=True):
            (self._path / name).unlink(missing_ok=True)
            with suppress(OSError):
                (self._path / name).parent.rmdir()  # only if the folder holds nothing else
        self._path.mkdir(exist_ok=True)
        listed &= {name for name in listed if os.path.lexists(self._path / name)}
        self._write_marker()
        OWNERS.add(self)

    def depth(self, path: Path) -> int:
        """Return the number of path parts of this folder if the folder contains `path`, else 0."""
        return (
            len(self._place.parts) if Path(os.path.abspath(path)).is_relative_to(self._place) else 0
        )

    def claim(self, path: Path) -> None:
        """Add a file to the list in the marker file; call this method before the file is written.

        Raises
        ------
        InputError
            If the file exists and is not listed in the marker file.
        """
        name = Path(os.path.abspath(path)).relative_to(self._place).as_posix()
        if PurePosixPath(name).name == MARKER:
            return
        with self._writing:
            listed = self._files.setdefault(self._kind, set())
            if name in listed and not _is_foreign(self._path, name):
                return
            if os.path.lexists(self._path / name) or _has_foreign_parent(self._path, name):
                raise _foreign(self._path, name, self._files)
            listed.add(name)
            self._write_marker()
            _claimed.add(self._place)

    def release(self) -> None:
        """Release the lock on the folder; a second call has no effect."""
        if self in OWNERS and not any(self._files.values()):
            # nothing was written: restore the previous state of the folder
            (self._path / MARKER).unlink(missing_ok=True)
        OWNERS.discard(self)
        self._lock.release()

    def __enter__(self) -> Self:
        try:
            self.begin()
        except BaseException:
            self.release()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def _write_marker(self) -> None:
        files = {kind: sorted(names) for kind, names in sorted(self._files.items())}
        data = {"format": FORMAT, "version": VERSION, "tissue": package_version(), "files": files}
        write_text(self._path / MARKER, json.dumps(data, indent=1) + "\n")


def anything_claimed() -> bool:
    """Return True if this process has listed a file in any output folder."""
    return bool(_claimed)


def require_folder(
    path: Path,
    kind: str,
    names: Iterable[str],
    *,
    overwrite: bool = False,
    shared: Iterable[str] = (),
) -> set[str]:
    """Check that an output can be written to a folder, without changing the folder.

    For the parameters, see `OwnedFolder`.

    Returns
    -------
    Names of the files of an earlier output of this kind, which the new output replaces.

    Raises
    ------
    InputError
        If the folder cannot be written, if it holds another kind of output, or if it holds files
        with these names that tissue did not write.
    """
    require_place(path, folder=True)
    files = listed_files(path)
    listed = files.get(kind, set())
    there = _present(path, names)
    for name in sorted(there | _present(path, shared)):
        if name not in listed or _is_foreign(path, name):
            raise _foreign(path, name, files)
    if there and not overwrite:
        raise InputError(
            "out",
            f"not contain another {kind}",
            path,
            "pass --overwrite (overwrite=True in Python) to replace it or choose another --out",
        )
    return there


def require_listed(path: Path, kind: str, name: str) -> None:
    """Check that a file may be replaced, even if another process has locked the folder.

    Raises
    ------
    InputError
        If the folder has a marker file, and the file exists but is not listed.
    """
    files = listed_files(path)
    is_listed = name in files.get(kind, {name})
    if os.path.lexists(path / name) and (not is_listed or _is_foreign(path, name)):
        raise _foreign(path, name, files)


def listed_files(path: Path) -> Files:
    """Read the names of the files that tissue wrote into a folder, keyed by kind of output.

    Raises
    ------
    InputError
        If the marker file was not written by tissue.
    """
    marker = path / MARKER
    if not os.path.lexists(marker):
        return {}
    try:
        if marker.is_symlink() or not marker.is_file() or marker.stat().st_size > LONGEST_MARKER:
            raise ValueError(marker)
        held = read_json(marker.read_text("utf-8"))
        is_known = held["format"] == FORMAT and held["version"] == VERSION
        files = {
            kind: set(names) for kind, names in held["files"].items() if isinstance(names, list)
        }
        are_inside = all(_is_inside(name) for names in files.values() for name in names)
        if not (is_known and are_inside and isinstance(held["tissue"], str)):
            raise ValueError(marker)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise InputError(
            "out",
            f"be a folder without a {MARKER} from another program or version",
            f"such a file in {path}",
            "choose another --out",
        ) from None
    return files


def _is_inside(name: object) -> bool:
    """Return True if a listed name is a path inside the folder."""
    if not isinstance(name, str) or not name or "\0" in name or "\\" in name:
        return False
    pure = PurePosixPath(name)
    return not pure.is_absolute() and ".." not in pure.parts and ":" not in pure.parts[0]


def _present(path: Path, names: Iterable[str]) -> set[str]:
    """Return the entries of a folder that match any of the names, including broken links."""
    found = set()
    for name in names:
        if "*" in name or "[0-9]" in name:
            found |= {each.relative_to(path).as_posix() for each in path.glob(name)}
        elif os.path.lexists(path / name):
            found.add(name)
        if _has_foreign_parent(path, name):
            found.add(name.partition("/")[0])
    return found


def _has_foreign_parent(path: Path, name: str) -> bool:
    """Return True if a folder of a relative file name is in fact a file or a symbolic link."""
    parents = [path / each for each in PurePosixPath(name).parents if each.name]
    return any(
        os.path.lexists(each) and (each.is_symlink() or not each.is_dir()) for each in parents
    )


def _is_foreign(path: Path, name: str) -> bool:
    """Return True if the entry with a listed name cannot be the file that tissue wrote."""
    entry = path / name
    changed = os.path.lexists(entry) and (entry.is_symlink() or not entry.is_file())
    return changed or _has_foreign_parent(path, name)


def _foreign(path: Path, name: str, files: Mapping[str, set[str]]) -> InputError:
    """Return the error for a folder with a file that does not belong to this kind of output."""
    owner = ""
    for kind, names in files.items():
        if name in names and not _is_foreign(path, name):
            owner = f", which belongs to another kind of output ({kind})"
    got = f"{path} with the file {name}{owner}"
    return InputError("out", "not contain files of other origin", got, "choose another --out")


class OutputLock:
    """Exclusive lock on an output folder or file, held until `release` or the end of this process.

    Parameters
    ----------
    out
        Output folder or file.
    folder
        True if `out` is a folder. A missing folder is created, and removed on release if it is
        still empty.

    Raises
    ------
    InputError
        If another process or another writer in this process holds the lock, or if the folder cannot
        be created.
    """

    def __init__(self, out: Path, *, folder: bool) -> None:
        require_place(out, folder=folder)
        place = (out if folder else out.parent).absolute()
        made = [each for each in (place, *place.parents) if not each.exists()]
        place.mkdir(parents=True, exist_ok=True)
        path = place / (LOCK if folder else f".{out.name}{LOCK}")
        self.release = weakref.finalize(self, _let_go, _taken(path, out), path, made)
        """Release the lock; a second call has no effect."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()


def _taken(path: Path, out: Path) -> TextIO:
    """Lock the lock file, write the id of this process into the file, and return the file."""
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
                "wait for that process, end it, or choose another --out",
            )
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # The previous holder removed the file: this lock protects nothing.
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    return file


def _opened(path: Path) -> TextIO:
    """Open the lock file; raise an error if a file of the user has its name."""
    plain = not path.is_symlink() and (path.is_file() or not path.exists())
    if plain:
        file = os.fdopen(
            # With 0o666, the user's umask determines the permissions.
            os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | NO_LINK, 0o666),
            "a+",
            encoding="utf-8",
        )
        if _is_lock(file):
            return file
        file.close()
    raise InputError(
        "out",
        f"not contain a file {path.name} of other origin",
        f"such a file in {path.parent}",
        "move this file or choose another --out",
    )


def _is_lock(file: TextIO) -> bool:
    """Return True if a file is empty or contains only a process id, like a lock file."""
    try:
        file.seek(0)
        held = file.read(LONGEST_LOCK + 1)
    except UnicodeDecodeError:
        return False
    except OSError:  # on Windows, locked bytes cannot be read: another writer holds the lock
        return True
    return not held or (held.strip().isdecimal() and len(held) <= LONGEST_LOCK)


def _lock(file: TextIO) -> bool:
    """Lock an open file; return True on success, or if the file system does not support locks."""
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
    """Remove and release the lock file, and remove created folders that stayed empty.

    The file is removed while it is still locked, so that no other process can lock it.
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
    """Return the id and start time [s since 1970] of this process, and the name of its computer."""
    import psutil

    return {
        "id": os.getpid(),
        "started_s": psutil.Process().create_time(),
        "machine": platform.node(),
    }


def is_alive(process: object) -> bool:
    """Return True if a process, described by the result of `identity`, still runs.

    A process on another computer cannot be checked; it is treated as running.
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
