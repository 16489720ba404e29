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

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.tets.checks import cell_faces, flatness, mean_ratio, pieces, pinched_edges, signed_volumes
from meshes.tets.report import FLAT, SLIVER, TetReport, millimetres, place
from meshes.tets.smoothing import smooth
from meshes.tets.tetrahedra import TetMesh

__all__ = ["FLAT", "SLIVER", "TetReport", "repair_tets"]

_DEBRIS = 0.01
_COINCIDENT = 1e-9


def repair_tets(
    nodes_m: NDArray[Any],
    cells: NDArray[Any],
    part: NDArray[Any] | None = None,
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
    nodes, cells = np.asarray(nodes_m, dtype=np.float64), np.asarray(cells, dtype=np.int64)
    parts = np.zeros(len(cells), dtype=np.uint8) if part is None else np.asarray(part, dtype=np.uint8)
    _require_numbers(nodes, cells)
    before = len(nodes)
    nodes, cells = _joined(nodes, cells)
    joined = before - len(nodes)
    count = len(cells)
    keep = np.sort(np.unique(np.sort(cells, axis=1), axis=0, return_index=True)[1])
    cells, parts = cells[keep], parts[keep]
    repeated = count - len(cells)
    flat = flatness(nodes, cells) < FLAT
    inverted = (signed_volumes(nodes, cells) < 0.0) & ~flat
    inverted_at = millimetres(nodes[cells[int(inverted.argmax())]]) if inverted.any() else None
    cells = np.where(inverted[:, None], cells[:, [0, 2, 1, 3]], cells)
    cells, parts, dropped = _without_flat(nodes, cells, parts)
    cells = _flat_turned(nodes, cells)
    _require_no_overlap(nodes, cells)
    cells, parts, debris = _without_debris(nodes, cells, parts)
    quality = mean_ratio(nodes, cells)
    sliver_count = int((quality < SLIVER).sum())
    sliver_at = millimetres(nodes[cells[int(quality.argmin())]]) if sliver_count else None
    flat_inside = int((flatness(nodes, cells) < FLAT).sum())
    nodes, moved = smooth(nodes, cells, _movable(len(nodes), cells, parts), SLIVER) if sliver_count else (nodes, 0)
    _require_volume(nodes, cells)
    used, where = np.unique(cells, return_inverse=True)
    mesh = TetMesh(nodes[used], where.reshape(cells.shape).astype(np.int64), parts, part_names)
    quality = mean_ratio(mesh.nodes_m, mesh.cells)
    pinched = pinched_edges(mesh.surface)
    size = np.ptp(mesh.nodes_m, axis=0) * 1e3
    report = TetReport(
        node_count=len(mesh.nodes_m),
        cell_count=len(mesh.cells),
        volume_mm3=float(mesh.volumes_m3.sum()) * 1e9,
        size_mm=(float(size[0]), float(size[1]), float(size[2])),
        joined_nodes=joined,
        repeated_cells=repeated,
        inverted=int(inverted.sum()),
        inverted_at_mm=inverted_at,
        flat_dropped=dropped,
        flat_moved=flat_inside,
        debris_mm3=tuple(1e9 * v for v in debris),
        bodies=int(pieces(mesh.cells).max()) + 1,
        slivers=sliver_count,
        slivers_left=int((quality < SLIVER).sum()),
        sliver_at_mm=sliver_at,
        nodes_moved=moved,
        smallest_share=float(mesh.volumes_m3.min() / mesh.volumes_m3.max()),
        smallest_at_mm=millimetres(mesh.nodes_m[mesh.cells[int(mesh.volumes_m3.argmin())]]),
        worst_quality=float(quality.min()),
        worst_at_mm=millimetres(mesh.nodes_m[mesh.cells[int(quality.argmin())]]),
        pinched=len(pinched),
        pinched_at_mm=millimetres(mesh.nodes_m[pinched[0]]) if len(pinched) else None,
    )
    return mesh, report


def _joined(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Nodes that no cell uses dropped, nodes on one point joined."""
    used, where = np.unique(cells, return_inverse=True)
    points = nodes[used]
    keys = np.round((points - points.min(axis=0)) / (_COINCIDENT * float(np.ptp(points, axis=0).max()) + 1e-300))
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return points[first[order]], rank[label.reshape(-1)][where].reshape(cells.shape).astype(np.int64)


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
    winding = _winding(triangles)
    of_solid = np.bincount(where, weights=winding * np.repeat(~flat, 4))[where]
    wrong = (winding * of_solid).reshape(-1, 4).sum(axis=1) > 0
    return np.where((flat & wrong)[:, None], cells[:, [0, 2, 1, 3]], cells)


def _winding(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """1 or -1 for the two windings of a triangle, shape (k,)."""
    a, b, c = triangles.T
    return np.sign(b - a) * np.sign(c - b) * np.sign(a - c)


def _whole(cells: NDArray[np.int64], keep: NDArray[np.bool_]) -> bool:
    """Whether dropping cells leaves as many pieces and no further pinched edge."""
    before, after = cells, cells[keep]
    if pieces(after).max() > pieces(before).max():
        return False
    return len(pinched_edges(_surface(after))) <= len(pinched_edges(_surface(before)))


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
    lowest, highest = np.full(count, 255), np.zeros(count, dtype=np.int64)
    np.minimum.at(lowest, cells, parts[:, None].astype(np.int64))
    np.maximum.at(highest, cells, parts[:, None].astype(np.int64))
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
        at = place(millimetres(nodes[triangles[crowded[0]]]))
        raise InputError(
            f"cells must meet two at a face, got {len(np.unique(where[crowded]))} faces of more, the first at {at} mm: "
            "mesh the surface again"
        )
    agree = np.bincount(where, weights=_winding(triangles))
    folded = np.flatnonzero((shared == 2) & (np.abs(agree[where]) == 2))
    if len(folded):
        at = place(millimetres(nodes[triangles[folded[0]]]))
        raise InputError(
            f"cells must not overlap, got {len(folded) // 2} faces with both cells on one side, the first at {at} mm: "
            "the mesh folds over itself, mesh the surface again"
        )


def _require_volume(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Refuse what is still flat or inverted."""
    bad = np.flatnonzero((flatness(nodes, cells) < FLAT) | (signed_volumes(nodes, cells) <= 0.0))
    if len(bad):
        at = place(millimetres(nodes[cells[bad[0]]]))
        raise InputError(
            f"cells must have volume, got {len(bad)} flat tetrahedra of {len(cells)} that neither dropping nor moving "
            f"nodes repairs, the first at {at} mm: mesh the surface again"
        )
