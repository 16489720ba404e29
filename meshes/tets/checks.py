"""Checks of tetrahedra: their quality, their neighbours, the pieces they form."""

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import in_brackets
from meshes.base.simplices import directed_edges

__all__ = [
    "EDGES",
    "FACES",
    "cell_faces",
    "flatness",
    "mean_ratio",
    "millimetres",
    "pieces",
    "pinched_edges",
    "place",
    "signed_volumes",
]

EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
"""Corners of the edges of a tetrahedron."""
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of the face opposite each corner, counter-clockwise seen from outside."""

Nodes = Array
Cells = Ints


def signed_volumes(nodes: Nodes, cells: Cells) -> Array:
    """Compute the volume of each tetrahedron in cubed units of the nodes, shape (m,).

    It is negative where a tetrahedron is inverted.
    """
    a, b, c, d = (nodes[cells[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def mean_ratio(nodes: Nodes, cells: Cells) -> Array:
    """Compute the mean ratio quality of each tetrahedron, shape (m,).

    It is 12 (3 V)^(2/3) over the sum of squared edges (Liu and Joe, 1994).

    1 for a regular tetrahedron, 0 for a flat one, negative for an inverted one; 0.84 for the corner
    of a cube.
    """
    volume = signed_volumes(nodes, cells)
    squares = _edge_squares(nodes, cells).sum(axis=0)
    return (
        12.0 * np.sign(volume) * (3.0 * np.abs(volume)) ** (2.0 / 3.0) / np.maximum(squares, 1e-300)
    )


def flatness(nodes: Nodes, cells: Cells) -> Array:
    """Compute six volumes over the cube of the longest edge, without sign, shape (m,).

    It is 0.71 for a regular tetrahedron.
    """
    longest = np.sqrt(_edge_squares(nodes, cells).max(axis=0))
    return 6.0 * np.abs(signed_volumes(nodes, cells)) / np.maximum(longest, 1e-300) ** 3


def cell_faces(cells: Cells) -> tuple[Ints, Ints, Ints]:
    """Return all faces of all cells, four per cell, wound outward.

    Also return the number of each face and the number of cells that share it.

    Returns
    -------
    Triangles, shape (4 m, 3); number of the unordered face, shape (4 m,); cells that share
    it, shape (4 m,).
    """
    triangles = cells[:, FACES].reshape(-1, 3)
    _, where, count = np.unique(
        np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return triangles, where, count[where]


def pieces(cells: Cells) -> Ints:
    """Return the number of the piece of each cell, shape (m,).

    Cells of a piece are linked through whole faces.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    where = cell_faces(cells)[1]
    owner = np.repeat(np.arange(len(cells)), 4)
    face = len(cells) + where
    links = coo_array(
        (np.ones(len(owner), dtype=np.int8), (owner, face)), shape=(face.max() + 1,) * 2
    )
    _, label = connected_components(links, directed=False)
    return np.unique(label[: len(cells)], return_inverse=True)[1]


def pinched_edges(surface: Cells) -> Ints:
    """Return edges that more than two of the triangles share, shape (k, 2)."""
    edges, uses = np.unique(np.sort(directed_edges(surface), axis=1), axis=0, return_counts=True)
    return edges[uses > 2]


def _edge_squares(nodes: Nodes, cells: Cells) -> Array:
    """Compute the squared length of each edge, shape (6, m)."""
    return np.stack(
        [((nodes[cells[:, i]] - nodes[cells[:, j]]) ** 2).sum(axis=1) for i, j in EDGES]
    )


def millimetres(points_m: Array) -> tuple[float, float, float]:
    """Return the mean of points [m], shape (n, 3), in mm."""
    x, y, z = 1e3 * points_m.mean(axis=0)
    return float(x), float(y), float(z)


def place(at_mm: tuple[float, ...]) -> str:
    """Format a place [mm] for users."""
    return in_brackets(at_mm, ".3g")
