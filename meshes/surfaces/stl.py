"""Binary STL: 84 bytes, then 50 for each triangle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

__all__ = ["read_binary_stl"]

_HEADER, _RECORD = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_binary_stl(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Corners, shape (3 m, 3), and triangles, shape (m, 3), of a file; None of one in text.

    Raises
    ------
    InputError
        If the file is not as long as its header states.
    """
    size = file.stat().st_size
    with file.open("rb") as stored:
        head = stored.read(_HEADER)
        count = int.from_bytes(head[80:], "little")
        if count == 0 or size != _HEADER + count * _RECORD.itemsize:
            if b"\0" not in head:  # text holds none; a count below 16 million does
                return None
            payload = max(size - _HEADER, 0) // _RECORD.itemsize
            stated = f"{count} triangles in its header" if size >= _HEADER else "a part of its header"
            raise InputError(
                f"file must be a whole STL surface, got {stated} and {payload} of them in {file.name}: it is cut off "
                "or damaged, export it again"
            )
        records = np.fromfile(stored, dtype=_RECORD, count=count)
    return records["corners"].reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3)
