"""Check and repair of tetrahedral meshes for finite-element simulation.

Defects are found and repaired by the rules in the table. V is the volume of a cell. If a defect
cannot be repaired, an error is raised.

==============  =====================================================  ================================================
defect          condition                                              repair
==============  =====================================================  ================================================
coincident      nodes within 1e-9 of the longest side                  merged; a cell with a merged edge becomes flat
repeated        cells of the same four nodes                           one cell is kept
inverted        negative volume, not flat                              reversed; error if cells then overlap
flat            6 V below 1e-6 of the longest edge cubed               removed at the surface if the mesh stays intact;
                                                                       inside, nodes are moved; otherwise error
debris          piece below 1 % of the largest piece's volume;         removed
                pieces are connected by faces
sliver          mean ratio below 0.1                                   inner nodes moved; the other slivers are kept
                                                                       and reported
pinched edge    surface edge of more than two triangles                kept and reported
==============  =====================================================  ================================================
"""  # noqa: E501 a table

from itertools import product

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Ints, compact, windings
from meshes.base.errors import InputError, by, counted
from meshes.tets.tetrahedra import (
    TetMesh,
    cell_faces,
    flatness,
    mean_ratio,
    outer_faces,
    pieces,
    pinched_edges,
    place,
    require_cells,
    signed_volumes,
)

# limits from the table above
_DEBRIS = 0.01
_COINCIDENT = 1e-9
FLAT = 1e-6
"""Ratio 6 V / (longest edge)^3 below which a tetrahedron is flat (regular: 0.71)."""
SLIVER = 0.1
"""Mean ratio below which a tetrahedron is a sliver (regular: 1)."""
_UNEVEN = 1e-3
"""Ratio of smallest to largest volume below which a mesh is reported as uneven.

The edges then differ by a factor of ten.
"""
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_SWEEPS = 3
"""Number of passes over the slivers.

Each pass moves nodes and changes the cells around them. The next pass may improve these cells
further.
"""
_FIRST_STEP = 0.25
_SMALLEST_STEP = 0.004
"""Step at which the pattern search for a better node position ends. It starts with `_FIRST_STEP`.

The steps are 1/4, 1/8 ... 1/128 of the size of the cells around the node.
"""


def describe(mesh: TetMesh) -> tuple[str, ...]:
    """Return sentences on size and quality of a mesh, and on defects that were not repaired."""
    nodes = mesh.nodes_m
    volumes = mesh.volumes_m3
    quality = mean_ratio(nodes, mesh.cells)
    found = [
        f"{len(mesh.cells)} tetrahedra on {len(nodes)} nodes, {1e6 * volumes.sum():.4g} ml, "
        f"{by(1e3 * np.ptp(nodes, axis=0), '.3g')} mm, lowest mean ratio "
        f"{quality.min():.2g} at {place(nodes[mesh.cells[quality.argmin()]])} mm."
    ]
    share = float(volumes.min() / volumes.max())
    if share < _UNEVEN:
        found.append(
            f"The smallest tetrahedron, at {place(nodes[mesh.cells[volumes.argmin()]])} mm, has "
            f"1/{1.0 / share:.0f} of the volume of the largest."
        )
    bodies = pieces(mesh.cells).max() + 1
    if bodies > 1:
        found.append(
            f"The mesh is {bodies} bodies not linked by faces: each needs its own support."
        )
    pinched = pinched_edges(mesh.surface)
    if len(pinched):
        found.append(
            f"Kept {len(pinched)} surface edges of more than two triangles (pinched, as at "
            f"{place(nodes[pinched[0]])} mm): stresses there mean little."
        )
    return tuple(found)


def repair_tets(
    nodes_m: NDArray[np.generic],
    cells: NDArray[np.generic],
    part: NDArray[np.integer] | None = None,
    part_names: tuple[str, ...] = ("body",),
) -> tuple[TetMesh, tuple[str, ...]]:
    """Repair a mesh as described in the table of the module docstring.

    Parameters
    ----------
    nodes_m
        Nodes [m], shape (n, 3).
    cells
        Nodes of each tetrahedron, in either orientation, shape (m, 4).
    part, part_names
        Part index of each cell, shape (m,), and names of the parts.

    Returns
    -------
    Mesh of tetrahedra with positive volume, and one sentence for each repaired defect. `describe`
    reports defects that are not repaired.

    Raises
    ------
    InputError
        If nodes are not finite, cells refer to nodes that do not exist, cells overlap each other,
        or flat tetrahedra cannot be repaired.
    """
    nodes = np.asarray(nodes_m, dtype=np.float64)
    tets = np.asarray(cells, dtype=np.int64)
    parts = np.zeros(len(tets), np.uint8) if part is None else np.asarray(part, np.uint8)
    if len(tets) == 0 or tets.ndim != 2 or tets.shape[1] != 4:
        raise InputError(
            "cells", "be tetrahedra", f"an array of shape {tets.shape}", "mesh the solid first"
        )
    require_cells(nodes, tets)
    notes = []
    count = len(nodes)
    nodes, tets = _joined(nodes, tets)
    if count > len(nodes):
        notes.append(f"Joined or dropped {count - len(nodes)} nodes that coincide or are unused.")
    keep = np.sort(np.unique(np.sort(tets, axis=1), axis=0, return_index=True)[1])
    if len(keep) < len(tets):
        notes.append(f"Dropped {len(tets) - len(keep)} tetrahedra that repeat another.")
    tets = tets[keep]
    parts = parts[keep]
    inverted = (signed_volumes(nodes, tets) < 0.0) & (flatness(nodes, tets) >= FLAT)
    if inverted.any():
        at = place(nodes[tets[inverted.argmax()]])
        notes.append(f"Turned {inverted.sum()} inverted tetrahedra, the first at {at} mm.")
    tets = np.where(inverted[:, None], tets[:, [0, 2, 1, 3]], tets)
    tets, parts, dropped = _without_flat(nodes, tets, parts)
    if dropped:
        notes.append(f"Dropped {dropped} flat tetrahedra at the surface.")
    tets = _flat_turned(nodes, tets)
    _require_no_overlap(nodes, tets)
    tets, parts, debris = _without_debris(nodes, tets, parts)
    if len(debris):
        notes.append(
            f"Dropped {len(debris)} loose pieces of {1e9 * debris.sum():.3g} mm3 together, the "
            f"largest {1e9 * debris.max():.3g} mm3."
        )
    flat = int((flatness(nodes, tets) < FLAT).sum())
    if flat:
        notes.append(f"Gave volume to {flat} flat tetrahedra inside by moving their nodes.")
    quality = mean_ratio(nodes, tets)
    slivers = int((quality < SLIVER).sum())
    if slivers:
        at = place(nodes[tets[quality.argmin()]])
        nodes, moved = smooth(nodes, tets, _movable(len(nodes), tets, parts), SLIVER)
        left = int((mean_ratio(nodes, tets) < SLIVER).sum())
        notes.append(
            f"Found {slivers} slivers (mean ratio below {SLIVER:g}), the worst at {at} mm. "
            f"After moving {counted(moved, 'inner node')}, {counted(left, 'sliver')} remained."
        )
    _require_volume(nodes, tets)
    return TetMesh(*compact(nodes, tets), parts, part_names), tuple(notes)


def _joined(nodes: Array, cells: Ints) -> tuple[Array, Ints]:
    """Remove nodes that no cell uses, and merge nodes at the same point."""
    points, cells = compact(nodes, cells)
    # 1e-300 avoids a division by zero if all nodes are at the same point.
    keys = np.round(
        (points - points.min(axis=0)) / (_COINCIDENT * float(np.ptp(points, axis=0).max()) + 1e-300)
    )
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return compact(points, first[label][cells])


def _without_flat(nodes: Array, cells: Ints, parts: Bytes) -> tuple[Ints, Bytes, int]:
    """Remove flat cells with a face on the surface.

    The cells are removed only if this does not pinch an edge or separate a piece of the mesh.
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
    """Orient flat cells such that their orientation agrees with neighbours that are not flat.

    The sign of a flat cell's volume is not reliable.
    """
    flat = flatness(nodes, cells) < FLAT
    if not flat.any():
        return cells
    triangles, where, _ = cell_faces(cells)
    winding = windings(triangles)
    of_solid = np.bincount(where, weights=winding * np.repeat(~flat, 4))[where]
    wrong = (winding * of_solid).reshape(-1, 4).sum(axis=1) > 0
    return np.where((flat & wrong)[:, None], cells[:, [0, 2, 1, 3]], cells)


def _whole(cells: Ints, keep: Flags) -> bool:
    """Return whether the mesh stays intact if only the cells flagged in `keep` remain.

    A mesh stays intact if the number of pieces and the number of pinched edges do not increase.
    """
    left = cells[keep]
    return pieces(left).max() <= pieces(cells).max() and (
        len(pinched_edges(outer_faces(left))) <= len(pinched_edges(outer_faces(cells)))
    )


def _without_debris(nodes: Array, cells: Ints, parts: Bytes) -> tuple[Ints, Bytes, Array]:
    """Remove pieces below 1 % of the largest piece's volume, and also return their volumes [m3]."""
    piece = pieces(cells)
    volumes = np.bincount(piece, weights=np.abs(signed_volumes(nodes, cells)))
    small = np.flatnonzero(volumes < _DEBRIS * volumes.max())
    keep = ~np.isin(piece, small)
    return cells[keep], parts[keep], np.asarray(volumes[small], dtype=np.float64)


def _movable(count: int, cells: Ints, parts: Bytes) -> Flags:
    """Return flags, shape (n,), of the nodes that are neither on the surface nor between parts."""
    inner = np.ones(count, dtype=bool)
    inner[outer_faces(cells)] = False
    # Parts are bytes, so 255 is larger than every part.
    lowest = np.full(count, 255, dtype=np.uint8)
    highest = np.zeros(count, dtype=np.uint8)
    np.minimum.at(lowest, cells, parts[:, None])
    np.maximum.at(highest, cells, parts[:, None])
    return inner & (lowest == highest)


def _require_no_overlap(nodes: Array, cells: Ints) -> None:
    """Raise an error if cells overlap.

    Cells overlap if a face has more than two cells, or if two neighbours lie on the same side of
    their common face.
    """
    triangles, where, shared = cell_faces(cells)
    crowded = np.flatnonzero(shared > 2)
    if len(crowded):
        at = place(nodes[triangles[crowded[0]]])
        raise InputError(
            "cells",
            "share each face with at most one other cell",
            (
                f"{counted(len(np.unique(where[crowded])), 'face')} of three or more cells, the "
                f"first at {at} mm"
            ),
            "mesh the surface again",
        )
    agree = np.bincount(where, weights=windings(triangles))
    folded = np.flatnonzero((shared == 2) & (np.abs(agree[where]) == 2))
    if len(folded):
        at = place(nodes[triangles[folded[0]]])
        raise InputError(
            "cells",
            "not overlap",
            (
                f"{counted(len(folded) // 2, 'face')} with both cells on the same side, the first "
                f"at {at} mm"
            ),
            "mesh the surface again, because this mesh folds over itself",
        )


def _require_volume(nodes: Array, cells: Ints) -> None:
    """Raise an error for cells that are still flat or inverted."""
    bad = np.flatnonzero((flatness(nodes, cells) < FLAT) | (signed_volumes(nodes, cells) <= 0.0))
    if len(bad):
        at = place(nodes[cells[bad[0]]])
        raise InputError(
            "cells",
            "have volume",
            (
                f"{len(bad)} of {len(cells)} cells that are flat after the repair, "
                f"the first at {at} mm"
            ),
            "mesh the surface again",
        )


def smooth(
    nodes: Array,
    cells: Ints,
    movable: Flags,
    enough: float,
) -> tuple[Array, int]:
    """Improve cells whose mean ratio is below `enough` by moving nodes of these cells.

    For each node, a pattern search maximises the lowest quality (mean ratio) of the cells at the
    node.

    A move is accepted only if the worst cell around the node improves.

    Parameters
    ----------
    nodes, cells
        Nodes, shape (n, 3), and cells, shape (m, 4).
    movable
        Whether a node may move, shape (n,).
    enough
        Mean ratio that is good enough. Cells with a larger mean ratio are not improved.

    Returns
    -------
    Nodes, shape (n, 3), and number of moved nodes.
    """
    nodes = nodes.copy()
    order = np.argsort(cells.ravel(), kind="stable")
    starts = np.searchsorted(cells.ravel()[order], np.arange(len(nodes) + 1))
    moved: set[int] = set()
    for _ in range(_SWEEPS):
        quality = mean_ratio(nodes, cells)
        bad = np.flatnonzero(quality < enough)
        # The worst cells come first, so their neighbours start from the improved nodes.
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
    """Find the position of a node that maximises the quality of the worst cell around the node.

    The result is None if no cell around the node needs improvement, or no better position is found.
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
            # The mean of the other corners is often the best position, so moves to it by half and
            # by the full distance are tried.
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
        # A smaller improvement is a rounding error, and the search would not end.
        if worst[best] > score + 1e-6:
            here = tries[best]
            score = float(worst[best])
        else:
            step *= 0.5
    return None if here is start else here
