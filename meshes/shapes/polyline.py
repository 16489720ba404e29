"""Points along a line through corners, by the path length from its first one."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["arc_length", "points_along"]

Array = NDArray[np.float64]


def arc_length(corners: ArrayLike) -> Array:
    """Path length from the first corner to each, shape (n,), in the unit of the corners, shape (n, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(np.asarray(corners), axis=0), axis=1))])


def points_along(corners: ArrayLike, lengths: ArrayLike) -> Array:
    """Points at some path lengths from the first corner, shape (m, 3); the ends beyond them."""
    along, given, at = arc_length(corners), np.asarray(corners), np.asarray(lengths, dtype=np.float64)
    return np.column_stack([np.interp(at, along, given[:, axis]) for axis in range(3)])
