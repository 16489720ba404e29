"""Tetrahedra made fit for a stiffness matrix: found, located, repaired by a stated rule, or refused.

==============  =====================================================  ================================================
what            when                                                   rule
==============  =====================================================  ================================================
coincident      nodes within 1e-9 of the longest side                  joined; cells that name a node twice are flat
repeated        cells of the same four nodes                           one is kept
inverted        volume negative, not flat                              turned; refused where cells then overlap
flat            6 V below 1e-6 of the longest edge cubed               dropped at the surface where that leaves the mesh
                                                                       whole; inside, its nodes are moved; else refused
debris          pieces linked by faces, below 1 % of the largest       dropped
sliver          mean ratio below 0.1                                   inner nodes moved; the rest is kept, reported
pinched edges   surface edges of more than two triangles               kept and reported
==============  =====================================================  ================================================
"""

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.simplices import compact, windings
from meshes.tets.checks import cell_faces, flatness, mean_ratio, pieces, pinched_edges, signed_volumes
from meshes.tets.report import FLAT, SLIVER, TetReport, millimetres, place
from meshes.tets.smoothing import smooth
from meshes.tets.tetrahedra import TetMesh

__all__ = ["FLAT", "SLIVER", "TetReport", "repair_tets"]

_DEBRIS = 0.01
_COINCIDENT = 1e-9


def repair_tets(
    nodes_m: NDArray[np.generic],
    cells: NDArray[np.generic],
    part: NDArray[np.integer] | None = None,
    part_names: tuple[str, ...] = ("body",),
) -> tuple[TetMesh, TetReport]:
    """Mesh of positive tetrahedra in one piece, and what was done, by the rules above.

    Parameters
    ----------
    nodes_m
        Nodes [m], shape (n, 3).
    cells
        Nodes of each tetrahedron, in either orientation, shape (m, 4).
    part, part_names
        Part of each cell, shape (m,), and the names.

    Raises
    ------
    InputError
        If nodes are not finite, cells name none or overlap, or flat tetrahedra cannot be repaired.
    """
    nodes, tets = np.asarray(nodes_m, dtype=np.float64), np.asarray(cells, dtype=np.int64)
    parts = np.zeros(len(tets), dtype=np.uint8) if part is None else np.asarray(part, dtype=np.uint8)
    _require_numbers(nodes, tets)
    given = nodes.shape[0], tets.shape[0]
    nodes, tets = _joined(nodes, tets)
    keep = np.sort(np.unique(np.sort(tets, axis=1), axis=0, return_index=True)[1])
    joined, repeated = given[0] - len(nodes), given[1] - len(keep)
    tets, parts = tets[keep], parts[keep]
    inverted = (signed_volumes(nodes, tets) < 0.0) & (flatness(nodes, tets) >= FLAT)
    inverted_at = _centre_mm(nodes, tets, inverted.argmax()) if inverted.any() else ()
    tets = np.where(inverted[:, None], tets[:, [0, 2, 1, 3]], tets)
    tets, parts, dropped = _without_flat(nodes, tets, parts)
    tets = _flat_turned(nodes, tets)
    _require_no_overlap(nodes, tets)
    tets, parts, debris = _without_debris(nodes, tets, parts)
    quality = mean_ratio(nodes, tets)
    slivers = int((quality < SLIVER).sum())
    sliver_at = _centre_mm(nodes, tets, quality.argmin()) if slivers else ()
    flat_inside = int((flatness(nodes, tets) < FLAT).sum())
    nodes, moved = smooth(nodes, tets, _movable(len(nodes), tets, parts), SLIVER) if slivers else (nodes, 0)
    _require_volume(nodes, tets)
    mesh = TetMesh(*compact(nodes, tets), parts, part_names)
    return mesh, TetReport(
        mesh=mesh,
        joined_nodes=joined,
        repeated_cells=repeated,
        inverted=int(inverted.sum()),
        inverted_at_mm=inverted_at,
        flat_dropped=dropped,
        flat_moved=flat_inside,
        debris_mm3=tuple(1e9 * v for v in debris),
        slivers=slivers,
        sliver_at_mm=sliver_at,
        nodes_moved=moved,
    )


def _centre_mm(nodes: NDArray[np.float64], cells: NDArray[np.int64], number: np.intp) -> tuple[float, float, float]:
    return millimetres(nodes[cells[number]])


def _joined(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Nodes that no cell uses dropped, nodes on one point joined."""
    points, cells = compact(nodes, cells)
    keys = np.round((points - points.min(axis=0)) / (_COINCIDENT * float(np.ptp(points, axis=0).max()) + 1e-300))
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return compact(points, first[label][cells])


def _without_flat(
    nodes: NDArray[np.float64], cells: NDArray[np.int64], parts: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.uint8], int]:
    """Flat cells with a face on the surface peeled off, as long as no new edge is pinched and no piece comes loose."""
    dropped = 0
    while True:
        flat = flatness(nodes, cells) < FLAT
        repeats = (np.diff(np.sort(cells, axis=1), axis=1) == 0).any(axis=1)
        if not flat.any():
            return cells, parts, dropped
        _, _, shared = cell_faces(cells)
        outer = (shared.reshape(-1, 4) == 1).any(axis=1)
        candidates = flat & (outer | repeats)
        keep = ~candidates
        if not candidates.any() or not keep.any() or not _whole(cells, keep):
            return cells, parts, dropped
        cells, parts, dropped = cells[keep], parts[keep], dropped + int(candidates.sum())


def _flat_turned(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Flat cells, whose own volume has no sign, turned where their solid neighbours require it."""
    flat = flatness(nodes, cells) < FLAT
    if not flat.any():
        return cells
    triangles, where, _ = cell_faces(cells)
    winding = windings(triangles)
    of_solid = np.bincount(where, weights=winding * np.repeat(~flat, 4))[where]
    wrong = (winding * of_solid).reshape(-1, 4).sum(axis=1) > 0
    return np.where((flat & wrong)[:, None], cells[:, [0, 2, 1, 3]], cells)


def _whole(cells: NDArray[np.int64], keep: NDArray[np.bool_]) -> bool:
    """Whether dropping cells leaves as many pieces and no further pinched edge."""
    left = cells[keep]
    return pieces(left).max() <= pieces(cells).max() and (
        len(pinched_edges(_surface(left))) <= len(pinched_edges(_surface(cells)))
    )


def _surface(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    triangles, _, shared = cell_faces(cells)
    return triangles[shared == 1]


def _without_debris(
    nodes: NDArray[np.float64], cells: NDArray[np.int64], parts: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.uint8], list[float]]:
    """Pieces of less than 1 % of the largest piece's volume dropped, and their volumes [m3]."""
    piece = pieces(cells)
    volumes = np.bincount(piece, weights=np.abs(signed_volumes(nodes, cells)))
    small = np.flatnonzero(volumes < _DEBRIS * volumes.max())
    keep = ~np.isin(piece, small)
    return cells[keep], parts[keep], [float(v) for v in volumes[small]]


def _movable(count: int, cells: NDArray[np.int64], parts: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Nodes inside, away from the surface and from where parts meet, shape (n,)."""
    inner = np.ones(count, dtype=bool)
    inner[_surface(cells)] = False
    lowest, highest = np.full(count, 255, dtype=np.uint8), np.zeros(count, dtype=np.uint8)
    np.minimum.at(lowest, cells, parts[:, None])
    np.maximum.at(highest, cells, parts[:, None])
    return inner & (lowest == highest)


def _require_numbers(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    if len(cells) == 0 or cells.ndim != 2 or cells.shape[1] != 4:
        raise InputError(f"cells must be tetrahedra, got an array of shape {cells.shape}: mesh the solid first")
    if cells.min() < 0 or cells.max() >= len(nodes):
        raise InputError(
            f"cells must name nodes 0 to {len(nodes) - 1}, got {cells.min()} to {cells.max()}: write the mesh again"
        )
    bad = int((~np.isfinite(nodes[np.unique(cells)]).all(axis=1)).sum())
    if bad:
        raise InputError(f"nodes must be finite, got {bad} of {len(nodes)} that are not: write the mesh again")


def _require_no_overlap(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Refuse faces of more than two cells, and neighbours that lie on the same side of their face."""
    triangles, where, shared = cell_faces(cells)
    crowded = np.flatnonzero(shared > 2)
    if len(crowded):
        at = place(_centre_mm(nodes, triangles, crowded[0]))
        raise InputError(
            f"cells must meet two at a face, got {len(np.unique(where[crowded]))} faces of more, the first at {at} mm: "
            "mesh the surface again"
        )
    agree = np.bincount(where, weights=windings(triangles))
    folded = np.flatnonzero((shared == 2) & (np.abs(agree[where]) == 2))
    if len(folded):
        at = place(_centre_mm(nodes, triangles, folded[0]))
        raise InputError(
            f"cells must not overlap, got {len(folded) // 2} faces with both cells on one side, the first at {at} mm: "
            "the mesh folds over itself, mesh the surface again"
        )


def _require_volume(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Refuse what is still flat or inverted."""
    bad = np.flatnonzero((flatness(nodes, cells) < FLAT) | (signed_volumes(nodes, cells) <= 0.0))
    if len(bad):
        at = place(_centre_mm(nodes, cells, bad[0]))
        raise InputError(
            f"cells must have volume, got {len(bad)} flat tetrahedra of {len(cells)} that neither dropping nor moving "
            f"nodes repairs, the first at {at} mm: mesh the surface again"
        )
