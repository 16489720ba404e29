"""Check and repair of tetrahedra for use in a stiffness matrix.

Defects are found, located, and repaired by a stated rule or refused.

==============  =====================================================  ================================================
what            when                                                   rule
==============  =====================================================  ================================================
coincident      nodes within 1e-9 of the longest side                  joined; cells that name a node twice are flat
repeated        cells of the same four nodes                           one is kept
inverted        volume negative, not flat                              turned; refused where cells then overlap
flat            6 V below 1e-6 of the longest edge cubed               dropped at the surface where that leaves the mesh
                                                                       whole; inside, its nodes are
                                                                       moved; else refused
debris          pieces linked by faces, below 1 % of the largest       dropped
sliver          mean ratio below 0.1                                   inner nodes moved; the rest is kept, reported
pinched edges   surface edges of more than two triangles               kept and reported
==============  =====================================================  ================================================
"""  # noqa: E501 a table

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Ints, compact, windings
from meshes.base.errors import InputError, by
from meshes.tets.tetrahedra import (
    TetMesh,
    cell_faces,
    flatness,
    mean_ratio,
    millimetres,
    pieces,
    pinched_edges,
    place,
    signed_volumes,
)

__all__ = ["FLAT", "SLIVER", "TetReport", "repair_tets", "smooth"]

_DEBRIS = 0.01
_COINCIDENT = 1e-9
FLAT = 1e-6
"""Six volumes over the longest edge cubed below which a tetrahedron is flat (0.71: regular)."""
SLIVER = 0.1
"""Mean ratio below which a tetrahedron is a sliver (1: regular)."""
_UNEVEN = 1e-3
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_SWEEPS = 3
_FIRST_STEP = 0.25
_SMALLEST_STEP = 0.004


@dataclass(frozen=True, eq=False)
class TetReport:
    """Defects found in a tetrahedral mesh and repairs made to it.

    Places are in mm in the frame of the mesh, empty if there is no place.

    Attributes
    ----------
    mesh
        The mesh returned.
    joined_nodes, repeated_cells
        Coincident nodes joined, cells dropped because another has the same nodes.
    inverted, inverted_at_mm, flat_dropped, flat_moved
        Cells turned and where the first was, flat cells dropped, flat cells given volume.
    debris_mm3
        Volume of each piece dropped.
    slivers, sliver_at_mm, nodes_moved
        Slivers found, where the worst was, inner nodes moved.
    """

    mesh: TetMesh
    joined_nodes: int
    repeated_cells: int
    inverted: int
    inverted_at_mm: tuple[float, ...]
    flat_dropped: int
    flat_moved: int
    debris_mm3: tuple[float, ...]
    slivers: int
    sliver_at_mm: tuple[float, ...]
    nodes_moved: int

    @property
    def slivers_left(self) -> int:
        """Slivers in the mesh returned."""
        return int((mean_ratio(self.mesh.nodes_m, self.mesh.cells) < SLIVER).sum())

    def sentences(self) -> tuple[str, ...]:
        """Describe defects and repairs, a sentence each; the first describes the mesh itself."""
        nodes = self.mesh.nodes_m
        cells = self.mesh.cells
        volumes = self.mesh.volumes_m3
        quality = mean_ratio(nodes, cells)
        pinched = pinched_edges(self.mesh.surface)
        bodies = pieces(cells).max() + 1
        worst, smallest = (
            place(millimetres(nodes[cells[each.argmin()]])) for each in (quality, volumes)
        )
        share = float(volumes.min() / volumes.max())
        found = [
            (
                True,
                f"{len(cells)} tetrahedra on {len(nodes)} nodes, {1e6 * volumes.sum():.4g} ml, "
                f"{by(1e3 * np.ptp(nodes, axis=0), '.3g')} mm, lowest mean ratio "
                f"{quality.min():.2g} at {worst} mm.",
            ),
            (
                share < _UNEVEN,
                (
                    f"The smallest tetrahedron, at {smallest} mm, has 1/{1.0 / share:.0f} of the "
                    "volume of the largest."
                ),
            ),
            (
                self.inverted,
                (
                    f"Turned {self.inverted} inverted tetrahedra, the first at "
                    f"{place(self.inverted_at_mm)} mm."
                ),
            ),
            (
                self.joined_nodes,
                f"Joined or dropped {self.joined_nodes} nodes that coincide or are unused.",
            ),
            (self.repeated_cells, f"Dropped {self.repeated_cells} tetrahedra that repeat another."),
            (self.flat_dropped, f"Dropped {self.flat_dropped} flat tetrahedra at the surface."),
            (
                self.flat_moved,
                f"Gave volume to {self.flat_moved} flat tetrahedra inside by moving their nodes.",
            ),
            (
                self.debris_mm3,
                f"Dropped {len(self.debris_mm3)} loose pieces of {sum(self.debris_mm3):.3g} "
                "mm3 together, the largest "
                f"{max(self.debris_mm3, default=0.0):.3g} mm3.",
            ),
            (
                bodies > 1,
                f"The mesh is {bodies} bodies not linked by faces: each needs its own support.",
            ),
            (
                self.slivers,
                f"Found {self.slivers} slivers (mean ratio below {SLIVER:g}), the worst at "
                f"{place(self.sliver_at_mm)} mm; moving {self.nodes_moved} inner nodes left "
                f"{self.slivers_left}.",
            ),
        ]
        notes = [sentence for is_so, sentence in found if is_so]
        if len(pinched):
            notes.append(
                f"Kept {len(pinched)} surface edges of more than two triangles (pinched, as at "
                f"{place(millimetres(nodes[pinched[0]]))} mm): stresses there mean little."
            )
        return tuple(notes)


def repair_tets(
    nodes_m: NDArray[np.generic],
    cells: NDArray[np.generic],
    part: NDArray[np.integer] | None = None,
    part_names: tuple[str, ...] = ("body",),
) -> tuple[TetMesh, TetReport]:
    """Return a mesh of positive tetrahedra in one piece, and the repairs, by the rules above.

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
        If nodes are not finite, cells name nodes that do not exist or overlap, or flat tetrahedra
        cannot be repaired.
    """
    nodes = np.asarray(nodes_m, dtype=np.float64)
    tets = np.asarray(cells, dtype=np.int64)
    parts = (
        np.zeros(len(tets), dtype=np.uint8) if part is None else np.asarray(part, dtype=np.uint8)
    )
    _require_numbers(nodes, tets)
    given = nodes.shape[0], tets.shape[0]
    nodes, tets = _joined(nodes, tets)
    keep = np.sort(np.unique(np.sort(tets, axis=1), axis=0, return_index=True)[1])
    joined = given[0] - len(nodes)
    repeated = given[1] - len(keep)
    tets = tets[keep]
    parts = parts[keep]
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
    nodes, moved = (
        smooth(nodes, tets, _movable(len(nodes), tets, parts), SLIVER) if slivers else (nodes, 0)
    )
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


def _centre_mm(nodes: Array, cells: Ints, number: np.intp) -> tuple[float, float, float]:
    return millimetres(nodes[cells[number]])


def _joined(nodes: Array, cells: Ints) -> tuple[Array, Ints]:
    """Drop nodes that no cell uses, and join nodes on one point."""
    points, cells = compact(nodes, cells)
    keys = np.round(
        (points - points.min(axis=0)) / (_COINCIDENT * float(np.ptp(points, axis=0).max()) + 1e-300)
    )
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return compact(points, first[label][cells])


def _without_flat(nodes: Array, cells: Ints, parts: Bytes) -> tuple[Ints, Bytes, int]:
    """Remove flat cells with a face on the surface.

    They are removed as long as no new edge is pinched and no piece comes loose.
    """
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
        cells = cells[keep]
        parts = parts[keep]
        dropped = dropped + int(candidates.sum())


def _flat_turned(nodes: Array, cells: Ints) -> Ints:
    """Turn flat cells, whose own volume has no sign, to agree with their solid neighbours."""
    flat = flatness(nodes, cells) < FLAT
    if not flat.any():
        return cells
    triangles, where, _ = cell_faces(cells)
    winding = windings(triangles)
    of_solid = np.bincount(where, weights=winding * np.repeat(~flat, 4))[where]
    wrong = (winding * of_solid).reshape(-1, 4).sum(axis=1) > 0
    return np.where((flat & wrong)[:, None], cells[:, [0, 2, 1, 3]], cells)


def _whole(cells: Ints, keep: Flags) -> bool:
    """Return whether dropping cells leaves as many pieces and no further pinched edge."""
    left = cells[keep]
    return pieces(left).max() <= pieces(cells).max() and (
        len(pinched_edges(_surface(left))) <= len(pinched_edges(_surface(cells)))
    )


def _surface(cells: Ints) -> Ints:
    triangles, _, shared = cell_faces(cells)
    return triangles[shared == 1]


def _without_debris(nodes: Array, cells: Ints, parts: Bytes) -> tuple[Ints, Bytes, list[float]]:
    """Drop pieces of less than 1 % of the largest piece's volume; return their volumes [m3]."""
    piece = pieces(cells)
    volumes = np.bincount(piece, weights=np.abs(signed_volumes(nodes, cells)))
    small = np.flatnonzero(volumes < _DEBRIS * volumes.max())
    keep = ~np.isin(piece, small)
    return cells[keep], parts[keep], [float(v) for v in volumes[small]]


def _movable(count: int, cells: Ints, parts: Bytes) -> Flags:
    """Return flags of the nodes away from the surface and from where parts meet, shape (n,)."""
    inner = np.ones(count, dtype=bool)
    inner[_surface(cells)] = False
    lowest = np.full(count, 255, dtype=np.uint8)
    highest = np.zeros(count, dtype=np.uint8)
    np.minimum.at(lowest, cells, parts[:, None])
    np.maximum.at(highest, cells, parts[:, None])
    return inner & (lowest == highest)


def _require_numbers(nodes: Array, cells: Ints) -> None:
    if len(cells) == 0 or cells.ndim != 2 or cells.shape[1] != 4:
        raise InputError(
            "cells", "be tetrahedra", f"an array of shape {cells.shape}", "mesh the solid first"
        )
    if cells.min() < 0 or cells.max() >= len(nodes):
        raise InputError(
            "cells",
            f"name nodes 0 to {len(nodes) - 1}",
            f"{cells.min()} to {cells.max()}",
            "write the mesh again",
        )
    bad = int((~np.isfinite(nodes[np.unique(cells)]).all(axis=1)).sum())
    if bad:
        raise InputError(
            "nodes", "be finite", f"{bad} of {len(nodes)} that are not", "write the mesh again"
        )


def _require_no_overlap(nodes: Array, cells: Ints) -> None:
    """Refuse faces of more than two cells.

    Also refuse neighbours that lie on the same side of their face.
    """
    triangles, where, shared = cell_faces(cells)
    crowded = np.flatnonzero(shared > 2)
    if len(crowded):
        at = place(_centre_mm(nodes, triangles, crowded[0]))
        raise InputError(
            "cells",
            "meet two at a face",
            f"{len(np.unique(where[crowded]))} faces of more, the first at {at} mm",
            "mesh the surface again",
        )
    agree = np.bincount(where, weights=windings(triangles))
    folded = np.flatnonzero((shared == 2) & (np.abs(agree[where]) == 2))
    if len(folded):
        at = place(_centre_mm(nodes, triangles, folded[0]))
        raise InputError(
            "cells",
            "not overlap",
            f"{len(folded) // 2} faces with both cells on one side, the first at {at} mm",
            "the mesh folds over itself, mesh the surface again",
        )


def _require_volume(nodes: Array, cells: Ints) -> None:
    """Refuse cells that are still flat or inverted."""
    bad = np.flatnonzero((flatness(nodes, cells) < FLAT) | (signed_volumes(nodes, cells) <= 0.0))
    if len(bad):
        at = place(_centre_mm(nodes, cells, bad[0]))
        raise InputError(
            "cells",
            "have volume",
            f"{len(bad)} flat tetrahedra of {len(cells)} that neither dropping nor moving "
            "nodes repairs, the first at "
            f"{at} mm",
            "mesh the surface again",
        )


def smooth(
    nodes: Array,
    cells: Ints,
    movable: Flags,
    enough: float,
) -> tuple[Array, int]:
    """Move nodes of cells worse than `enough` by pattern search.

    The search maximises the worst mean ratio around each node.

    A move is kept only where the worst cell around the node improves, so no cell falls below the
    worst one next to it.

    Parameters
    ----------
    nodes, cells
        Nodes, shape (n, 3), and cells, shape (m, 4).
    movable
        Whether a node may move, shape (n,).
    enough
        Mean ratio above which a cell is not improved.

    Returns
    -------
    Nodes, shape (n, 3), and the number of nodes moved.
    """
    nodes = nodes.copy()
    order = np.argsort(cells.ravel(), kind="stable")
    starts = np.searchsorted(cells.ravel()[order], np.arange(len(nodes) + 1))
    moved: set[int] = set()
    for _ in range(_SWEEPS):
        quality = mean_ratio(nodes, cells)
        bad = np.flatnonzero(quality < enough)
        # Worst cells first: their neighbours start from the improved nodes.
        wanted = cells[bad[np.argsort(quality[bad])]].ravel()
        wanted = wanted[np.sort(np.unique(wanted, return_index=True)[1])]
        changed = 0
        for node in wanted[movable[wanted]]:
            star = cells[order[starts[node] : starts[node + 1]] // 4]
            best = _best_place(nodes, star, int(node), enough)
            if best is not None:
                nodes[node] = best
                moved.add(int(node))
                changed += 1
        if not changed:
            break
    return nodes, len(moved)


def _best_place(nodes: Array, star: Ints, node: int, enough: float) -> Array | None:
    """Find the place of a node where the worst cell around it is best.

    Return None if no cell around the node needs improvement.
    """
    corners = nodes[star]
    slot = star == node
    here = nodes[node]
    size = float(np.abs(corners - here).max())
    score = float(mean_ratio(nodes, star).min())
    if score >= enough:
        return None
    start = here
    step = _FIRST_STEP
    centre = corners[~slot].mean(axis=0)
    while step > _SMALLEST_STEP:
        tries = np.concatenate(
            [here + step * size * _DIRECTIONS, here + np.array([[0.5], [1.0]]) * (centre - here)]
        )
        moved = np.where(slot[None, :, :, None], tries[:, None, None, :], corners[None])
        flat = moved.reshape(-1, 3)
        worst = (
            mean_ratio(flat, np.arange(len(flat)).reshape(-1, 4))
            .reshape(len(tries), -1)
            .min(axis=1)
        )
        best = int(worst.argmax())
        if worst[best] > score + 1e-6:
            here = tries[best]
            score = float(worst[best])
        else:
            step *= 0.5
    return None if here is start else here
