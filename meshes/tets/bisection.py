"""Refinement of tetrahedra by halving them at their longest edges.

An edge that is the longest of every tetrahedron around it is split at its middle, and so are these
tetrahedra. The mesh stays conforming without any repair. Where a tetrahedron with an edge to split
has a longer edge, the longer edge is split first (Rivara 1997, Int. J. Numer. Methods Eng.
40:3313). Shapes stay bounded. The surface stays in place, or its nodes are moved onto a given
surface. Flat triangles 20 mm long lie up to 0.8 mm below a surface of 60 mm radius, for any
division.
"""

from collections.abc import Callable

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.tets.checks import EDGES, cell_faces, signed_volumes
from meshes.tets.tetrahedra import TetMesh

__all__ = ["Move", "bisected"]

Move = Callable[[Array], Array]
"""Points [m], shape (n, 3), to points [m] of that shape."""
_MOST_CELLS = 5_000_000
_LEAST_VOLUME = 0.5
"""Share of its volume that every tetrahedron around a node must keep when the node is moved.

A node is moved onto the surface only if every tetrahedron does.
"""


def bisected(
    mesh: TetMesh,
    size_m: Callable[[Array], Array],
    *,
    onto: Move | None = None,
) -> TetMesh:
    """Return a mesh in which no edge is longer than wanted at its middle.

    Nodes of the first mesh keep their numbers.

    Parameters
    ----------
    mesh
        Mesh to refine.
    size_m
        Longest edge wanted [m], shape (n,), at points [m], shape (n, 3).
    onto
        Function that returns the nearest points of the surface that the mesh represents. The mesh's
        surface nodes, old and new, are moved there.

    Raises
    ------
    InputError
        If a wanted edge is not positive, or the mesh would pass five million tetrahedra.
    """
    nodes = mesh.nodes_m
    cells = mesh.cells
    part = mesh.part
    if onto is not None:
        nodes = _moved(nodes, cells, mesh.surface_nodes, onto)
    while True:
        ends = np.sort(cells[:, EDGES], axis=2)
        keys, edge = np.unique(ends.reshape(-1, 2) @ np.array([len(nodes), 1]), return_inverse=True)
        a = keys // len(nodes)
        b = keys % len(nodes)
        middle = 0.5 * (nodes[a] + nodes[b])
        length = np.linalg.norm(nodes[a] - nodes[b], axis=1)
        wanted = size_m(middle)
        if not (wanted > 0.0).all():
            raise InputError(
                "size_m",
                "be positive everywhere",
                f"{1e3 * wanted.min():.4g} mm",
                "use a hundredth of the body",
            )
        rank = np.empty(len(keys), dtype=np.int64)
        # Ties go by number, the same for every tetrahedron.
        rank[np.lexsort((keys, np.round(length / length.max(), 12)))] = np.arange(len(keys))
        edge = edge.reshape(-1, 6)
        place = rank[edge].argmax(axis=1)
        longest = np.take_along_axis(edge, place[:, None], axis=1)[:, 0]
        around = np.bincount(edge.ravel(), minlength=len(keys))
        marked = length > wanted
        while True:  # edges that block a long edge are split first
            waiting = np.zeros(len(keys), dtype=bool)
            waiting[longest[marked[edge].any(axis=1)]] = True
            if not (waiting & ~marked).any():
                break
            marked |= waiting
        split = (np.bincount(longest, minlength=len(keys)) == around) & marked
        halved = np.flatnonzero(split[longest])
        if len(halved) == 0:
            return TetMesh(nodes, cells, part, mesh.part_names)
        if len(cells) + len(halved) > _MOST_CELLS:
            raise InputError(
                "size_m",
                f"leave at most {_MOST_CELLS} tetrahedra",
                f"edges of {1e3 * wanted.min():.4g} mm",
                "use longer ones",
            )
        number = len(nodes) + np.cumsum(split) - 1
        nodes = np.concatenate([nodes, middle[split]])
        cells = np.concatenate([cells, cells[halved]])
        part = np.concatenate([part, part[halved]])
        first, second = EDGES[place[halved]].T
        copies = np.arange(len(cells) - len(halved), len(cells))
        cells[halved, second] = cells[copies, first] = number[longest[halved]]
        if onto is not None:
            triangles, _, shared = cell_faces(cells)
            outside = np.unique(triangles[shared == 1])
            nodes = _moved(nodes, cells, outside[outside >= len(nodes) - split.sum()], onto)


def _moved(nodes: Array, cells: Ints, chosen: Ints, onto: Move) -> Array:
    """Move the chosen nodes onto the surface.

    Nodes whose move would flatten a tetrahedron stay in place.
    """
    moved = nodes.copy()
    before = signed_volumes(nodes, cells)
    moved[chosen] = onto(nodes[chosen])
    while (flat := signed_volumes(moved, cells) < _LEAST_VOLUME * before).any():
        back = np.unique(cells[flat])
        moved[back] = nodes[back]
    return moved
