"""Which cells hang on a support, and which are debris."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from tissue.models.tooth.grid import HexGrid
from tissue.models.tooth.supports import NodeSupports, PointSprings

__all__ = ["supported_cells"]

LEAST_RESTRAINT = 1e-9
"""Share of the largest eigenvalue of a part's restraint below which it can move: rounding is 1e-16, a part held at
three corners of a cell 1e-2."""
ENOUGH = 200
"""Springs spread over a part that are tried before all of them."""


def supported_cells(
    grid: HexGrid, filled: NDArray[np.bool_], supports: NodeSupports, springs: PointSprings,
    springs_cell: NDArray[np.int32],
) -> NDArray[np.bool_]:  # fmt: skip
    """Cells of ``filled``, shape (c,), that a support holds against all six rigid motions, given the springs' cells.

    Cells that share a face move together. A part made of such cells is carried if its supports, and the nodes it shares
    with parts that are carried, leave it no rigid motion. A part that meets the rest in one node or one edge only is
    not carried: it would turn about it freely, and the stiffness would be singular.
    """
    at = tuple(grid.cell_place.T)
    box = np.zeros(grid.cell_place.max(axis=0) + 1, dtype=np.bool_)
    box[at] = filled
    numbered, count = label(box)
    part_of = numbered[at] - 1
    held = supports.fixed.copy()
    on_part = np.where(springs_cell >= 0, part_of[springs_cell], -1)
    supported = np.zeros(count, dtype=np.bool_)
    members = _members(grid, part_of, count)
    waiting = list(range(count))
    moved = True
    while moved and waiting:
        moved = False
        for number in list(waiting):
            if _restrained(grid, members[number], held, springs.chosen(on_part == number)):
                supported[number] = moved = True
                held[members[number]] = True
                waiting.remove(number)
    return filled & supported[part_of] if count else filled


def _members(grid: HexGrid, part_of: NDArray[np.integer], count: int) -> list[NDArray[np.int64]]:
    """Nodes of each part."""
    cells = np.argsort(part_of, kind="stable")
    starts = np.searchsorted(part_of[cells], np.arange(count + 1))
    members, inside = [], np.zeros(grid.node_count, dtype=np.bool_)
    for a, b in pairwise(starts):
        inside[:] = False
        inside[grid.cell_nodes[cells[a:b]]] = True
        members.append(np.flatnonzero(inside))
    return members


def _restrained(grid: HexGrid, nodes: NDArray[np.integer], held: NDArray[np.bool_], springs: PointSprings) -> bool:
    """Whether what holds these nodes, and springs at points between them, leave no rigid motion."""
    some = nodes[held[nodes].any(axis=1)]
    if len(some) + len(springs.position_m) == 0:
        return False
    if len(springs.position_m) > 2 * ENOUGH:  # what some of them restrain, all of them do
        few = np.zeros(len(springs.position_m), dtype=np.bool_)
        few[:: len(few) // ENOUGH] = True
        if _restrained(grid, nodes[:0], held, springs.chosen(few)):
            return True
    place = grid.node_place[some].astype(np.float64)
    sprung = (springs.position_m - grid.origin_m) / grid.edge_m
    centre = np.concatenate([place, sprung]).mean(axis=0)
    place -= centre
    restraint = springs.restraint(grid.origin_m + grid.edge_m * centre, grid.edge_m)
    restraint /= max(float(np.trace(restraint[:3, :3])), np.finfo(float).tiny)
    for axis in range(3):
        along = np.eye(3)[axis]
        here = place[held[some, axis]]
        rows = np.concatenate([np.tile(along, (len(here), 1)), np.cross(here, along)], axis=1)
        restraint += rows.T @ rows
    values = np.linalg.eigvalsh(restraint)
    return bool(values[0] > LEAST_RESTRAINT * values[-1])
