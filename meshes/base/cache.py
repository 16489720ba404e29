"""On-disk cache for expensive arrays, and in-memory store of recent results.

A cache entry is identified by all inputs of the computation whose results it holds.
"""

import hashlib
import os
import sys
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.whole_file import package_version, whole_file

_CODE = "version of the code"
"""Name of the array in a cache file that contains the version of the code, as text."""
_DIGEST_BYTES = 16
"""Size of a checksum [byte]. The chance that two of 1e9 entries have the same checksum is 2e-21."""
Arrays = dict[str, NDArray[Any]]


def cache_folder() -> Path:
    """Return the folder in which computed arrays are cached.

    The folder is ``TISSUE_CACHE`` if this environment variable is set, else the user's cache
    folder.
    """
    named = os.environ.get("TISSUE_CACHE")
    if named:
        return Path(named)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "tissue"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "tissue"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissue"


def cached_arrays(kind: str, key: Iterable[object], make: Callable[[], Arrays]) -> Arrays:
    """Return arrays from the cache, or compute and store them.

    Parameters
    ----------
    kind
        Kind of the arrays, one word. The file name starts with this word. If the meaning of the
        arrays changes, use another word, so that older files are not read.
    key
        All inputs of the computation. Arrays are identified by their bytes, other values by their
        ``repr``.
    make
        Function that computes the arrays.

    Notes
    -----
    A file contains the arrays, their checksums, and the version of the code. This version covers
    tissue and the module that defines ``make``. The arrays are computed again if the file cannot be
    read, or if a checksum or the version does not match. If the folder cannot be written, nothing
    is stored.
    """
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in key:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(repr(part).encode())
    path = cache_folder() / f"{kind}-{digest.hexdigest()}.npz"
    code = _code(make)
    # zipfile, zlib and NumPy raise many types of errors for a damaged file. If one byte of the
    # header of an array is changed, for example, NumPy may raise tokenize.TokenError.
    with suppress(Exception), np.load(path, allow_pickle=False) as stored:
        # The archive contains a checksum of each array, which is compared when the array is read.
        kept = {name: stored[name] for name in stored.files}
        if str(kept.pop(_CODE)) == code:
            return kept
    arrays = {name: np.asarray(array) for name, array in make().items()}
    # An unwritable folder or a full disk must not end the computation.
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            np.savez(temporary, **{_CODE: np.array(code)}, **arrays)  # type: ignore[arg-type]
    return arrays


def _code(make: Callable[[], Arrays]) -> str:
    """Return the version of tissue and of the module that defines a function."""
    module = sys.modules.get(make.__module__)
    try:
        source = (
            Path(module.__file__).read_bytes() if module is not None and module.__file__ else b""
        )
    except OSError:
        # A module without a source file, as in a frozen program, is identified only by the version
        # of tissue.
        source = b""
    # 64 bits are enough to distinguish the few versions of one module.
    return f"{package_version()} {hashlib.blake2b(source, digest_size=8).hexdigest()}"


Result = TypeVar("Result")


class RecentResults(Generic[Result]):
    """In-memory store of the most recently requested results.

    The store saves time, because the trials of a case study request the same meshes, voxels and
    tables many times.

    Parameters
    ----------
    most
        Largest number of stored results. The least recently requested result is removed first.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[Hashable, Result] = {}

    def __len__(self) -> int:
        return len(self._results)

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return the stored result of a key, or compute and store it.

        All callers share the result and must not change it.
        """
        found = self._results.pop(key, None)
        if found is None:
            found = make()
        self._results[key] = found
        while len(self._results) > self._most:
            del self._results[next(iter(self._results))]
        return found
