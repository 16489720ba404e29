"""Tree of boxes around the triangles of a surface, for fast searches of the nearest triangle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array

LEAF = 4
"""Number of triangles in a leaf, the same as in `kernels.structure_distance`."""
LONGEST_M = 0.5e-3
"""Edge length [m] above which a triangle near the query points is bisected."""
BY_DISTANCE = 0.25
"""Increase of the length limit `LONGEST_M` per distance of a triangle from the query points."""
BISECTIONS = 2
"""Largest number of bisections of a triangle.

The value limits the cost of a search for the smallest distance. For a 3.2 mm drill in a coaxial
tube of 48 sides, the search evaluates 1,100 distance bounds. Without this limit, it would evaluate
more than 20,000 bounds, because all parts of the facets are equally near to the drill.
"""
_GRID = 1024
"""Number of cells along each axis in the grid of the Morton curve.

With 10 bits per axis, the indices along the three axes fit in one integer.
"""


@dataclass(frozen=True, eq=False)
class BoxTree:
    """Complete binary tree of boxes. The children of node i are the nodes 2 i + 1 and 2 i + 2.

    Attributes
    ----------
    centres_m, halves_m
        Centre and half sides [m], shape (nodes, 3), of the box around all triangles in the subtree
        of each node. The half sides are -1 for a node without triangles.
    corners_m
        Corners [m], shape (triangles, 3, 3), of the triangles in the order of the leaves. Each leaf
        has `LEAF` triangles.
    first_leaf
        Index of the first leaf node.
    """

    centres_m: Array
    halves_m: Array
    corners_m: Array
    first_leaf: int


def box_tree(corners_m: Array) -> BoxTree:
    """Build a tree around triangles, given by their corners [m], shape (n, 3, 3)."""
    corners = _in_order(corners_m)
    leaves = 1 << max(int(np.ceil(np.log2(-(-len(corners) // LEAF)))), 0)
    padded = np.full((leaves * LEAF, 3, 3), np.nan)
    padded[: len(corners)] = corners
    points = padded.reshape(leaves, 3 * LEAF, 3)
    low = np.where(np.isnan(points), np.inf, points).min(axis=1)
    high = np.where(np.isnan(points), -np.inf, points).max(axis=1)
    levels = [(low, high)]
    while len(low) > 1:
        low = np.minimum(low[0::2], low[1::2])
        high = np.maximum(high[0::2], high[1::2])
        levels.append((low, high))
    lows, highs = (np.concatenate(each) for each in zip(*levels[::-1], strict=True))
    empty = ~np.isfinite(lows)
    # A half side of -1 marks a box without triangles.
    lows[empty] = 2.0
    highs[empty] = 0.0
    return BoxTree(0.5 * (lows + highs), 0.5 * (highs - lows), corners, leaves - 1)


def cut_long(corners_m: Array, box_m: Array | None = None) -> Array:
    """Bisect triangles with long edges, at most `BISECTIONS` times.

    Bisected triangles have smaller boxes in the tree, which makes searches faster.

    Parameters
    ----------
    corners_m
        Corners of the triangles [m], shape (n, 3, 3).
    box_m
        Corners with the smallest and the largest coordinates of a box around the query points [m],
        shape (2, 3). Triangles far from this box may keep longer edges. If None, all triangles have
        the same limit.
    """
    done: list[Array] = []
    rest = corners_m
    for _ in range(BISECTIONS):
        edges = np.linalg.norm(np.roll(rest, -1, axis=1) - rest, axis=2)
        long = edges.max(axis=1) > LONGEST_M + BY_DISTANCE * _away(rest.mean(axis=1), box_m)
        done.append(rest[~long])
        rest = _halves(rest[long], edges[long].argmax(axis=1))
    return np.concatenate([*done, rest])


def _halves(corners: Array, longest: NDArray[np.intp]) -> Array:
    """Bisect each triangle at the edge that starts at its corner with the index `longest`."""
    turned = np.take_along_axis(
        corners, ((longest[:, None] + np.arange(3)) % 3)[:, :, None], axis=1
    )
    a = turned[:, 0]
    b = turned[:, 1]
    c = turned[:, 2]
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _away(points: Array, box: Array | None) -> Array:
    """Compute the distance [m] of points from a box, which is 0 inside the box."""
    if box is None:
        return np.zeros(len(points))
    outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
    return np.linalg.norm(outside, axis=1)


def _in_order(corners: Array) -> Array:
    """Sort triangles along a Morton curve, so that neighbouring triangles share a leaf."""
    centres = corners.mean(axis=1)
    low = centres.min(axis=0)
    # For a single triangle, the extent is zero. It lies in cell 0 for any cell size.
    size = float(np.ptp(centres, axis=0).max()) or 1.0
    cells = np.minimum((centres - low) / size * _GRID, _GRID - 1).astype(np.int64)
    code = np.zeros(len(cells), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return corners[np.argsort(code, kind="stable")]
