"""Arrays as text in JSON, small: quantised, as differences, in planes of bytes, deflated;
`decode.js` reads them.
"""

import zlib
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Record", "packed", "packed_column", "packed_mesh", "packed_shares", "packed_vectors"]

Record = dict[str, Any]
"""Values that JSON can hold."""
LARGEST = 32767
"""Steps to either side of a quantised number of 16 bits."""
STEPS = 255
"""Steps of a colour."""


def packed(values: NDArray[np.integer[Any]], *, differences: bool = True) -> Record:
    """Encode integers of 8 bits (unsigned), 16 or 32 (signed), shape (rows,) or (rows, columns).

    Differences between rows are wrapped around, and negative differences become odd numbers. Small
    differences of either sign therefore have high bytes of 0. All first bytes come before all
    second bytes, column by column.
    """
    rows = values if values.ndim == 2 else values[:, None]
    size = rows.dtype.itemsize
    whole = rows.astype(f"i{size}").astype(np.int64)
    if differences:
        step = np.diff(whole, axis=0, prepend=0).astype(f"i{size}").astype(np.int64)
        whole = (step << 1) ^ (step >> 63)
    planes = (
        np.ascontiguousarray(whole.astype(f"<u{size}").T)
        .reshape(-1)
        .view(np.uint8)
        .reshape(-1, size)
        .T
    )
    return {
        "rows": rows.shape[0],
        "columns": rows.shape[1],
        "kind": f"{rows.dtype.kind}{size}",
        "differences": differences,
        "data": b64encode(zlib.compress(np.ascontiguousarray(planes).tobytes(), 9)).decode("ascii"),
    }


def packed_vectors(values: ArrayLike) -> Record:
    """Encode numbers in 65,532 steps over the widest column's range: ``low`` + ``step`` * (whole +
    32767).

    A 0 stays exactly 0.
    """
    rows = np.asarray(values, dtype=np.float64)
    low, high = (
        (rows.min(axis=0), rows.max(axis=0)) if len(rows) else (np.zeros(rows.shape[1:]),) * 2
    )
    widest = float(np.max(high - low, initial=0.0)) or float(np.abs(rows).max(initial=0.0))
    step = widest / (2 * LARGEST - 2) or 1.0
    low = step * np.floor(low / step)
    whole = np.rint((rows - low) / step) - LARGEST
    return {"low": low.tolist(), "step": step, **packed(whole.astype(np.int16))}


def packed_column(values: ArrayLike) -> Record:
    """Encode one column of numbers as `packed_vectors` does."""
    return packed_vectors(np.asarray(values, dtype=np.float64)[:, None])


def packed_shares(values: ArrayLike) -> Record:
    """Encode shares from 0 to 1 of a colour scale in steps of 1/255."""
    return packed(
        np.rint(STEPS * np.clip(np.nan_to_num(np.asarray(values)), 0.0, 1.0)).astype(np.uint8)
    )


def packed_mesh(points_mm: ArrayLike, triangles: ArrayLike) -> tuple[Record, NDArray[np.intp]]:
    """Encode a surface, and return the order in which its points are kept.

    Unused points are left out. Points come in the order in which triangles first name them. A
    corner is encoded as its distance below the next new point, 0 for the new point itself.
    """
    corners = np.asarray(triangles, dtype=np.intp).reshape(-1, 3).ravel()
    used, first, at = np.unique(corners, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    named = place[at.reshape(-1)]
    unnamed = np.maximum.accumulate(np.concatenate([[-1], named]))[:-1] + 1
    record = {
        "points": packed_vectors(np.asarray(points_mm, dtype=np.float64)[used[order]]),
        "corners": packed((unnamed - named).astype(np.int32)[:, None], differences=False),
    }
    return record, used[order]
