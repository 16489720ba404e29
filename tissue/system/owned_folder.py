"""Output folders in which a command writes its files and touches no file of the user."""

import json
import os
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path, PurePosixPath

from meshes.base.errors import InputError
from meshes.base.text_tables import read_json
from meshes.base.whole_file import OWNERS, package_version, whole_file
from tissue.system.outputs import OutputLock, require_place

__all__ = [
    "MARKER",
    "OwnedFolder",
    "anything_claimed",
    "listed_files",
    "owned_folder",
    "require_folder",
    "require_listed",
]

MARKER = ".tissue.json"
"""Name of the marker file, which lists the files that tissue wrote into a folder."""
FORMAT = "tissue output folder"
VERSION = 1
"""Format and version that the marker states."""
LONGEST_MARKER = 1 << 24
"""Largest marker that is read [bytes]; a file of 40,000 names has 2 MB."""

_claimed: set[Path] = set()
"""Folders for which this process has listed a file."""
Files = dict[str, set[str]]
"""Names of files relative to their folder, by kind of output."""


class OwnedFolder:
    """Output folder that one command locks and fills.

    The marker lists each file before it is written. Only files that the marker lists are replaced
    or removed. While the folder is held, `whole_file` claims each file in it, so that no writer can
    replace a file of the user.

    Parameters
    ----------
    path
        The folder.
    kind
        Kind of output, such as ``run``; it stands in the marker and in messages.
    names
        Names of the files that may be written, relative to the folder, with ``*`` and ``[0-9]`` as
        in `Path.glob`.
    overwrite
        Remove the files of an earlier output of this kind.
    shared
        Names of files that every output of this kind replaces, ``overwrite`` or not.
    adopted
        Files that count as listed where the marker lists no output of this kind.

    Raises
    ------
    InputError
        If the folder holds another output, or foreign files under these names, or another process
        writes to it.
    """

    def __init__(
        self,
        path: Path,
        kind: str,
        names: Iterable[str],
        *,
        overwrite: bool = False,
        shared: Iterable[str] = (),
        adopted: Collection[str] = (),
    ) -> None:
        self._kind = kind
        self._adopted = adopted
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
            adopted=adopted,
        )
        self._check()
        self._lock = OutputLock(path, folder=True)

    def begin(self) -> None:
        """Remove the files of an earlier output and mark the folder as an output of tissue."""
        replaced = self._check()  # another process may have written here since the first check
        self._files = listed_files(self._path)
        listed = self._files.setdefault(self._kind, set(self._adopted))
        self._write_marker()
        for name in sorted(replaced, reverse=True):
            (self._path / name).unlink(missing_ok=True)
            with suppress(OSError):
                (self._path / name).parent.rmdir()  # only where nothing else is left in it
        self._path.mkdir(exist_ok=True)
        listed &= {name for name in listed if os.path.lexists(self._path / name)}
        self._write_marker()
        OWNERS.add(self)

    def depth(self, path: Path) -> int:
        """Return how many parts the folder's path has if it holds ``path``, else 0."""
        return (
            len(self._place.parts) if Path(os.path.abspath(path)).is_relative_to(self._place) else 0
        )

    def claim(self, path: Path) -> None:
        """List a file of this folder in the marker before it is written.

        Raises
        ------
        InputError
            If the file is there and the marker does not list it.
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
        """Release the folder; a second call does nothing."""
        if self in OWNERS and not any(self._files.values()):
            # nothing was written: restore the previous state of the folder
            (self._path / MARKER).unlink(missing_ok=True)
        OWNERS.discard(self)
        self._lock.release()

    def _write_marker(self) -> None:
        files = {kind: sorted(names) for kind, names in sorted(self._files.items())}
        data = {"format": FORMAT, "version": VERSION, "tissue": package_version(), "files": files}
        with whole_file(self._path / MARKER) as temporary:
            temporary.write_text(json.dumps(data, indent=1) + "\n", "utf-8")


def anything_claimed() -> bool:
    """Return whether this process has begun to write a file into an output folder."""
    return bool(_claimed)


@contextmanager
def owned_folder(
    path: Path,
    kind: str,
    names: Iterable[str],
    *,
    overwrite: bool = False,
    shared: Iterable[str] = (),
    adopted: Collection[str] = (),
) -> Iterator[None]:
    """Hold an output folder while the block writes its files; see `OwnedFolder`."""
    folder = OwnedFolder(path, kind, names, overwrite=overwrite, shared=shared, adopted=adopted)
    try:
        folder.begin()
        yield
    finally:
        folder.release()


def require_folder(
    path: Path,
    kind: str,
    names: Iterable[str],
    *,
    overwrite: bool = False,
    shared: Iterable[str] = (),
    adopted: Collection[str] = (),
) -> set[str]:
    """Check that a folder can take an output, without any change.

    For the parameters, see `OwnedFolder`.

    Returns
    -------
    Files of an earlier output of this kind, which the new output replaces.

    Raises
    ------
    InputError
        If the folder cannot be written, or holds another output or foreign files under these names.
    """
    require_place(path, folder=True)
    files = listed_files(path)
    listed = files.get(kind, set(adopted))
    there = _present(path, names)
    for name in sorted(there | _present(path, shared)):
        if name not in listed or _is_foreign(path, name):
            raise _foreign(path, name, files)
    if there and not overwrite:
        raise InputError(
            "out",
            f"not hold another {kind}",
            path,
            "pass --overwrite to replace it or choose another --out",
        )
    return there


def require_listed(path: Path, kind: str, name: str) -> None:
    """Check that a file may be replaced in a folder that another process may hold.

    Raises
    ------
    InputError
        If the folder has a marker that does not list a file which is there.
    """
    files = listed_files(path)
    is_listed = name in files.get(kind, {name})
    if os.path.lexists(path / name) and (not is_listed or _is_foreign(path, name)):
        raise _foreign(path, name, files)


def listed_files(path: Path) -> Files:
    """Read the names of files written by tissue, by kind of output; empty without a marker.

    Raises
    ------
    InputError
        If the marker was not written by tissue.
    """
    marker = path / MARKER
    if not os.path.lexists(marker):
        return {}
    try:
        if marker.is_symlink() or not marker.is_file() or marker.stat().st_size > LONGEST_MARKER:
            raise ValueError(marker)
        held = read_json(marker.read_text("utf-8"))
        if (
            held["format"] != FORMAT
            or held["version"] != VERSION
            or not isinstance(held["tissue"], str)
        ):
            raise ValueError(marker)
        files = {
            kind: set(names) for kind, names in held["files"].items() if isinstance(names, list)
        }
        if not all(_is_inside(name) for names in files.values() for name in names):
            raise ValueError(marker)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise InputError(
            "out",
            f"hold no {MARKER} of other origin or version",
            f"one in {path}",
            "choose another --out",
        ) from None
    return files


def _is_inside(name: object) -> bool:
    """Return whether a name of the marker stays within its folder."""
    if not isinstance(name, str) or not name or "\0" in name or "\\" in name:
        return False
    pure = PurePosixPath(name)
    return not pure.is_absolute() and ".." not in pure.parts and ":" not in pure.parts[0]


def _present(path: Path, names: Iterable[str]) -> set[str]:
    """Return the entries of a folder that match one of these names, including broken links."""
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
    """Return whether a part of a name before the last one exists and is not a plain folder."""
    parents = [
        path.joinpath(*PurePosixPath(name).parts[:count])
        for count in range(1, len(PurePosixPath(name).parts))
    ]
    return any(
        os.path.lexists(each) and (each.is_symlink() or not each.is_dir()) for each in parents
    )


def _is_foreign(path: Path, name: str) -> bool:
    """Return whether the entry with a listed name cannot be the file that tissue wrote."""
    entry = path / name
    changed = os.path.lexists(entry) and (entry.is_symlink() or not entry.is_file())
    return changed or _has_foreign_parent(path, name)


def _foreign(path: Path, name: str, files: Mapping[str, set[str]]) -> InputError:
    """Return the error for a folder with a file that is not part of this kind of output."""
    owner = ""
    for kind, names in files.items():
        if name in names and not _is_foreign(path, name):
            owner = f", which belongs to another kind of output ({kind})"
    got = f"{path} with {name}{owner}"
    return InputError("out", "not hold files of other origin", got, "choose another --out")
