"""Points along a line through corners, by the path length from its first one."""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints

__all__ = ["arc_length", "kept_corners", "points_along"]


def arc_length(corners: ArrayLike) -> Array:
    """Compute the path length from the first corner to each corner, shape (n,).

    It has the unit of the corners, shape (n, 3).
    """
    return np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(np.asarray(corners), axis=0), axis=1))]
    )


def points_along(corners: ArrayLike, lengths: ArrayLike) -> Array:
    """Return points at some path lengths from the first corner, shape (m, 3).

    Lengths beyond an end give the end.
    """
    along = arc_length(corners)
    given = np.asarray(corners)
    at = np.asarray(lengths, dtype=np.float64)
    return np.column_stack([np.interp(at, along, given[:, axis]) for axis in range(3)])


def kept_corners(corners: ArrayLike, within: float) -> Ints:
    """Return the indices of the corners to keep, ascending (Douglas and Peucker 1973).

    Every other corner lies within a distance of the line through the kept corners.

    Parameters
    ----------
    corners
        Shape (n, 3).
    within
        That distance, in the unit of the corners.
    """
    given = np.asarray(corners, dtype=np.float64)
    kept = {0, len(given) - 1}
    open_legs = [(0, len(given) - 1)]
    while open_legs:
        first, last = open_legs.pop()
        if last - first < 2:
            continue
        along = given[last] - given[first]
        between = given[first + 1 : last] - given[first]
        share = np.clip(between @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        off = np.linalg.norm(between - share[:, None] * along, axis=1)
        if off.max() > within:
            farthest = first + 1 + int(np.argmax(off))
            kept.add(farthest)
            open_legs += [(first, farthest), (farthest, last)]
    return np.array(sorted(kept), dtype=np.int64)
