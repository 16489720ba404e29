"""Arrays that are dear to compute, kept on disk by the hash of what they were computed from."""

import hashlib
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from meshes.whole_file import whole_file

__all__ = ["cache_folder", "cached_arrays"]

Arrays = dict[str, NDArray[np.generic]]


def cache_folder() -> Path:
    """Where computed arrays are kept: ``TISSUE_CACHE`` if it is set, else the user's cache folder."""
    named = os.environ.get("TISSUE_CACHE")
    if named:
        return Path(named)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "tissue"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "tissue"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissue"


def cached_arrays(kind: str, key: Iterable[object], make: Callable[[], Arrays]) -> Arrays:
    """Arrays from the cache, or made now and put there.

    Parameters
    ----------
    kind
        What they are, in a word: the start of the file's name. Change it with the meaning of the arrays.
    key
        Everything they depend on: arrays by their bytes, all else by its ``repr``.
    make
        Computes them.

    Notes
    -----
    A file that cannot be read is computed again; a folder that cannot be written is done without.
    """
    digest = hashlib.blake2b(digest_size=16)
    for part in key:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(repr(part).encode())
    path = cache_folder() / f"{kind}-{digest.hexdigest()}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, BadZipFile, EOFError, KeyError):
        pass
    arrays = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as beside:
            np.savez(beside, **arrays)  # type: ignore[arg-type]
    except OSError:
        pass
    return arrays
