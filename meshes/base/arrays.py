"""Array types, lattice points, and functions for triangles and cells (rows of indices)."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]
Integers = NDArray[np.integer]
Floats = NDArray[np.floating]
Numbers = NDArray[np.number]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Singles = NDArray[np.float32]
Triangles = tuple[Array, Ints]
"""Vertices, shape (n, 3), and vertex indices of each triangle, shape (m, 3)."""


def lattice(*axes: ArrayLike) -> Any:
    """Return the lattice points, shape (n, number of axes), for the coordinates on each axis.

    The last axis varies fastest.
    """
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def box_of(mask: Flags, margin: int = 0) -> tuple[slice, ...]:
    """Return slices of a nonempty mask's bounding box with a margin [voxel] on each side.

    The box stays within the array.
    """
    found = []
    for axis, count in enumerate(mask.shape):
        along = np.flatnonzero(mask.any(axis=tuple(k for k in range(mask.ndim) if k != axis)))
        found.append(slice(max(int(along[0]) - margin, 0), min(int(along[-1]) + 1 + margin, count)))
    return tuple(found)


def compact(points: Array, cells: Ints) -> tuple[Array, Ints]:
    """Return the points that cells use, shape (n, 3), and the cells, shape (m, k).

    The returned cells contain indices of the returned points.
    """
    used = np.zeros(len(points), dtype=bool)
    used[cells] = True
    return (points, cells) if used.all() else (points[used], (np.cumsum(used) - 1)[cells])


def directed_edges(triangles: Ints) -> Ints:
    """Return the indices of the start and end points, shape (3 m, 2), of the edges of m triangles.

    The result contains the first edges of all triangles, then the second edges, then the third
    edges.
    """
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def windings(triangles: Ints) -> Ints:
    """Return the orientation of each triangle, shape (m,), relative to its vertex indices.

    The value is -1 if the indices ascend in cyclic order (such as 0, 1, 2 or 1, 2, 0), and 1 for
    the reverse order. The value is 0 if a triangle uses a point twice.
    """
    a, b, c = triangles.T
    return np.sign(b - a) * np.sign(c - b) * np.sign(a - c)


def cross_products(points: Array, triangles: Ints) -> Array:
    """Compute a normal vector, shape (m, 3), of each triangle.

    The length of the vector is twice the area of the triangle.
    """
    corner = points[triangles[:, 0]]
    first_edge = points[triangles[:, 1]] - corner
    second_edge = points[triangles[:, 2]] - corner
    return np.cross(first_edge, second_edge)


def enclosed_volume(points: Array, triangles: Ints) -> float:
    """Compute the volume inside triangles with outward normals, in the cubed unit of the points."""
    # Sum the volumes of the tetrahedra between the centroid and each triangle, a sixth of the
    # triple product. A distant origin instead of the centroid would cause rounding errors.
    corners = points - points.mean(axis=0)
    return (
        float(np.einsum("ij,ij->", corners[triangles[:, 0]], cross_products(corners, triangles)))
        / 6.0
    )
