"""Where a triangle surface passes through itself."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.simplices import directed_edges

__all__ = ["crossing_triangles"]

_AT_ONCE = 20_000


def crossing_triangles(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles that an edge without a vertex in common passes through, in rising order.

    Edges that only touch a triangle, and triangles that overlap in one plane, do not count.
    """
    from scipy.spatial import cKDTree

    edges = np.unique(np.sort(directed_edges(faces), axis=1), axis=0)
    corners, ends = vertices[faces], vertices[edges]
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    # Long edges would widen every search: edges are searched by classes of length.
    length_class = np.ceil(np.log2(half / half.max() + 1e-300)).astype(np.int64)
    crossed: list[NDArray[np.int64]] = []
    for one in np.unique(length_class):
        members = np.flatnonzero(length_class == one)
        tree = cKDTree(ends[members].mean(axis=1))
        for start in range(0, len(faces), _AT_ONCE):
            block = np.arange(start, min(start + _AT_ONCE, len(faces)))
            near = tree.query_ball_point(centres[block], reach[block] + half[members].max())
            triangle = np.repeat(block, [len(n) for n in near])
            edge = members[np.concatenate([np.asarray(n, dtype=np.int64) for n in near])]
            crossed.append(triangle[_pass_through(vertices, faces[triangle], edges[edge])])
    return np.unique(np.concatenate(crossed))


def _pass_through(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], edges: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether the edge passes through the triangle, pair by pair."""
    apart = (triangles[:, :, None] != edges[:, None, :]).all(axis=(1, 2))
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    p, q = vertices[edges[:, 0]], vertices[edges[:, 1]]
    normal = np.cross(b - a, c - a)
    sides = np.einsum("ij,ij->i", p - a, normal) * np.einsum("ij,ij->i", q - a, normal)
    around = np.stack([np.einsum("ij,ij->i", q - p, np.cross(u - p, v - p)) for u, v in ((a, b), (b, c), (c, a))])
    return np.asarray(apart & (sides < 0.0) & ((around > 0.0).all(axis=0) | (around < 0.0).all(axis=0)))
