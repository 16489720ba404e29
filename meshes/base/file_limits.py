"""Checks that an input file is a regular file, and that its content fits in memory."""

import os
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.errors import InputError, require_positive

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_GB = 1e9
_FREE_SHARE = 0.5
"""Share of the free memory that a file's content may use.

The remaining memory is for results that are computed from the content.
"""
_limit_GB: ContextVar[float | None] = ContextVar("max_memory_GB", default=None)
_LONGEST_HEADER = 1 << 16
"""Number of bytes read for the header of a NumPy array.

NumPy refuses headers above 10,000 bytes.
"""
_CGROUP = Path("/sys/fs/cgroup")


@contextmanager
def memory_limit(max_memory_GB: float | None) -> Iterator[None]:
    """Set the memory limit [GB] for the content of files that are read in a ``with`` block.

    The value None does not change the limit.
    """
    if max_memory_GB is None:
        yield
        return
    token = _limit_GB.set(
        require_positive("max_memory_GB", max_memory_GB, "leave it out, or use about 8")
    )
    try:
        yield
    finally:
        _limit_GB.reset(token)


def given_limit_GB() -> float | None:
    """Return the limit [GB] that `memory_limit` set; None if no limit is set."""
    return _limit_GB.get()


def memory_limit_bytes() -> int:
    """Return the number of bytes that the content of a file may use.

    The number is the limit set by `memory_limit`, or half of the free memory if no limit is set.
    """
    given = _limit_GB.get()
    return int(given * _GB) if given is not None else int(_FREE_SHARE * _free_bytes())


def require_memory(needed: int, file: str, content: str) -> None:
    """Raise an error if the decoded content of a file exceeds the memory limit.

    Parameters
    ----------
    needed
        Size of the decoded content [byte].
    file
        Name of the file.
    content
        Content according to the header, such as "4000 x 4000 x 600 voxels".

    Raises
    ------
    InputError
        If the content is larger than the limit. The message names the option that raises the limit.
    """
    limit = memory_limit_bytes()
    if needed <= limit:
        return
    source = "the given limit" if _limit_GB.get() is not None else "half of the free memory"
    raise InputError(
        "file",
        f"fit into {limit / _GB:.3g} GB of memory ({source})",
        f"{content} in {file}, which take {needed / _GB:.3g} GB",
        (
            "crop or resample the data, or raise the limit with --max-memory-GB "
            "(max_memory_GB in Python)"
        ),
    )


def require_regular(file: Path) -> Path:
    """Check that a path is a regular file or does not exist, and return the path.

    Devices such as /dev/zero have no end, and a named pipe blocks until a process writes into it.
    For a path that does not exist, the code that opens the file reports the error.

    Raises
    ------
    InputError
        If the path is a folder, a device, a named pipe or a socket.
    """
    try:
        mode = file.stat().st_mode
    except (OSError, ValueError):
        return file  # it is missing or has an impossible name: the code that opens it reports that
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device, a named pipe or a socket"
        raise InputError(
            "file", "be a regular file", f"{file}, which is {kind}", "copy its content to a file"
        )
    return file


def read_npz(path: Path) -> "dict[str, NDArray[np.generic]]":
    """Check the sizes of the arrays in a NumPy archive, and read the arrays.

    The sizes stated in the headers are compared with the file size and the memory limit.

    Raises
    ------
    InputError
        If the arrays would exceed the memory limit.
    ValueError
        If the array size in a header does not match the size of the archive entry, or an array
        contains Python objects.
    """
    import numpy as np

    require_regular(path)
    with zipfile.ZipFile(path) as archive:
        entries = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
        require_memory(
            sum(entry.file_size for entry in entries), path.name, f"{len(entries)} arrays"
        )
        for entry in entries:
            with archive.open(entry) as stream:
                stated = _npy_bytes(stream.read(_LONGEST_HEADER))
                if stated != entry.file_size:
                    raise ValueError(
                        f"{entry.filename} states {stated} bytes but has another number"
                    )
    with np.load(path, allow_pickle=False) as stored:
        return {
            name: stored[name]
            for name in (entry.filename.removesuffix(".npy") for entry in entries)
        }


def _npy_bytes(first: bytes) -> int:
    """Return the array size [byte] stated in the first bytes of a NumPy array file."""
    import numpy as np

    stream = BytesIO(first)
    version = np.lib.format.read_magic(stream)
    # In version 1, the length of the header is stored in two bytes, in later versions in four
    # bytes.
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.hasobject:
        # The size of Python objects is unknown, and reading pickled objects can run any code.
        raise ValueError("an array of objects")
    return len(first) - len(stream.read()) + prod(shape) * dtype.itemsize


def _free_bytes() -> int:
    """Return the memory [byte] that this process may still use.

    The limits of the machine, the container and the process are taken into account.
    """
    import psutil

    free = [int(psutil.virtual_memory().available)]
    try:
        held = int((_CGROUP / "memory.current").read_text())
        free.append(int((_CGROUP / "memory.max").read_text()) - held)
    except (OSError, ValueError):
        pass  # no container, or no limit
    if os.name == "posix":
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            free.append(most - int(psutil.Process().memory_info().vms))
    return max(min(free), 0)
