"""Arrays that two processes see at once, in a file that stays in memory where the system has such a place."""

import json
import mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["MEMORY", "AnyArray", "Layout", "SharedArrays"]

AnyArray = NDArray[Any]
Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Type and shape of each array by its name."""
MEMORY = Path("/dev/shm")
"""Files that never reach a disk, on Linux; elsewhere the system's folder for what is temporary serves."""
TRIES = 20
"""How often a read is tried again."""
ALIGNED = 64
"""Bytes to which every array is aligned: a line of the cache."""


class SharedArrays:
    """Named arrays in one mapped file; both sides write and read them as NumPy arrays, without a call to the system.

    What must be read whole goes through `write` and `read`: the reader tries again while a write is running. There is
    one writer for each array.

    Parameters
    ----------
    folder
        Where the file lies; the side that makes it gives ``layout``, the other finds it there.
    layout
        The arrays to make, all zero.
    """

    def __init__(self, folder: Path, layout: Layout | None = None) -> None:
        if layout is not None:
            (folder / "layout.json").write_text(json.dumps(layout), "utf-8")
        table: Layout = json.loads((folder / "layout.json").read_text("utf-8"))
        places, end = {}, 0
        for name, (dtype, shape) in table.items():
            size = int(np.prod(shape)) * np.dtype(dtype).itemsize
            places[name] = (end, dtype, tuple(shape))
            end += -(-size // ALIGNED) * ALIGNED
        file = folder / "arrays.bin"
        if layout is not None:
            with file.open("wb") as made:
                made.truncate(max(end, 1))
        with file.open("r+b") as opened:
            self._map = mmap.mmap(opened.fileno(), 0)
        self._arrays: dict[str, AnyArray] = {
            name: np.ndarray(shape, dtype, buffer=self._map, offset=first)
            for name, (first, dtype, shape) in places.items()
        }

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __getitem__(self, name: str) -> AnyArray:
        """The array itself."""
        return self._arrays[name]

    def write(self, name: str, values: AnyArray) -> None:
        """Write an array whose name with ``_turn`` is its counter, odd while the write is running."""
        turn = self._arrays[f"{name}_turn"]
        turn[0] += 1
        self._arrays[name][:] = values
        turn[0] += 1

    def read(self, name: str) -> tuple[int, NDArray[Any]] | None:
        """The number of an array's writes and a whole copy of it; None where a writer was busy, or died."""
        turn, values = self._arrays[f"{name}_turn"], self._arrays[name]
        for _ in range(TRIES):
            before = int(turn[0])
            copy = values.copy()
            if before % 2 == 0 and int(turn[0]) == before:
                return before // 2, copy
        return None
