"""Checks of tetrahedra: their quality, their neighbours, the pieces they form."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.tets.tetrahedra import FACES

__all__ = ["cell_faces", "flatness", "mean_ratio", "pieces", "pinched_edges", "signed_volumes"]

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def signed_volumes(nodes: NDArray[Any], cells: NDArray[Any]) -> NDArray[np.float64]:
    """Volume of each tetrahedron in cubed units of the nodes, negative where it is inverted, shape (m,)."""
    a, b, c, d = (nodes[cells[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def mean_ratio(nodes: NDArray[Any], cells: NDArray[Any]) -> NDArray[np.float64]:
    """Quality of each tetrahedron, shape (m,): 12 (3 V)^(2/3) over the sum of squared edges (Liu and Joe, 1994).

    1 for a regular tetrahedron, 0 for a flat one, negative for an inverted one; 0.84 for the corner of a cube.
    """
    volume = signed_volumes(nodes, cells)
    squares = _edge_squares(nodes, cells).sum(axis=0)
    return 12.0 * np.sign(volume) * (3.0 * np.abs(volume)) ** (2.0 / 3.0) / np.maximum(squares, 1e-300)


def flatness(nodes: NDArray[Any], cells: NDArray[Any]) -> NDArray[np.float64]:
    """Six volumes over the cube of the longest edge, without sign, shape (m,): 0.71 for a regular tetrahedron."""
    longest = np.sqrt(_edge_squares(nodes, cells).max(axis=0))
    return 6.0 * np.abs(signed_volumes(nodes, cells)) / np.maximum(longest, 1e-300) ** 3


def cell_faces(cells: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """All faces of all cells, four a cell, wound outward; the number of each face and how many cells share it.

    Returns
    -------
    Triangles, shape (4 m, 3); number of the unordered face, shape (4 m,); cells that share it, shape (4 m,).
    """
    triangles = cells[:, FACES].reshape(-1, 3)
    _, where, count = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    where = where.reshape(-1)
    return triangles, where, count[where]


def pieces(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Number of the piece of each cell, shape (m,): cells of a piece are linked through whole faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, where, _ = cell_faces(cells)
    count = len(cells)
    owner = np.repeat(np.arange(count), 4)
    links = coo_array(
        (np.ones(len(owner), dtype=np.int8), (owner, count + where)), shape=(count + where.max() + 1,) * 2
    )
    _, label = connected_components(links, directed=False)
    _, piece = np.unique(label[:count], return_inverse=True)
    return piece.reshape(-1).astype(np.int64)


def pinched_edges(surface: NDArray[Any]) -> NDArray[np.int64]:
    """Edges that more than two of the triangles share, shape (k, 2)."""
    edges = np.sort(np.concatenate([surface[:, [0, 1]], surface[:, [1, 2]], surface[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    return unique[uses > 2].astype(np.int64)


def _edge_squares(nodes: NDArray[Any], cells: NDArray[Any]) -> NDArray[np.float64]:
    """Squared length of each edge, shape (6, m)."""
    return np.stack([((nodes[cells[:, i]] - nodes[cells[:, j]]) ** 2).sum(axis=1) for i, j in _EDGES])
