"""Which cells hang on a support, and which are debris."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tissue.models.tooth.grid import HexGrid
from tissue.models.tooth.supports import NodeSupports, PointSprings

__all__ = ["supported_cells"]

LEAST_RESTRAINT = 1e-9
"""Share of the largest eigenvalue of a part's restraint below which it can move: rounding is 1e-16, a part held at
three corners of a cell 1e-2."""


def supported_cells(
    grid: HexGrid, filled: NDArray[np.bool_], supports: NodeSupports, springs: PointSprings
) -> NDArray[np.bool_]:
    """Cells of ``filled``, shape (c,), that a support holds against all six rigid motions.

    Cells that share a face move together. A part made of such cells is carried if its supports, and the nodes it shares
    with parts that are carried, leave it no rigid motion. A part that meets the rest in one node or one edge only is
    not carried: it would turn about it freely, and the stiffness would be singular.
    """
    pairs = grid.face_pairs[filled[grid.face_pairs].all(axis=1)]
    links = coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(grid.cell_count,) * 2)
    _, part = connected_components(links, directed=False)
    numbers, part = np.unique(part[filled], return_inverse=True)
    part_of = np.full(grid.cell_count, -1)
    part_of[filled] = part
    held = supports.fixed.copy()
    sprung = grid.locate(springs.position_m)[0]
    on_part = np.where(sprung >= 0, part_of[sprung], -1)
    supported = np.zeros(len(numbers), dtype=np.bool_)
    members = _members(grid, part_of, len(numbers))
    waiting = list(range(len(numbers)))
    moved = True
    while moved and waiting:
        moved = False
        for number in list(waiting):
            if _restrained(grid, members[number], held, springs.chosen(on_part == number)):
                supported[number] = moved = True
                held[members[number]] = True
                waiting.remove(number)
    return filled & supported[part_of] if len(numbers) else filled


def _members(grid: HexGrid, part_of: NDArray[np.integer], count: int) -> list[NDArray[np.int32]]:
    """Nodes of each part."""
    cells = np.argsort(part_of, kind="stable")
    starts = np.searchsorted(part_of[cells], np.arange(count + 1))
    return [np.unique(grid.cell_nodes[cells[a:b]]) for a, b in pairwise(starts)]


def _restrained(grid: HexGrid, nodes: NDArray[np.int32], held: NDArray[np.bool_], springs: PointSprings) -> bool:
    """Whether what holds these nodes, and springs at points between them, leave no rigid motion."""
    some = nodes[held[nodes].any(axis=1)]
    if len(some) + len(springs.position_m) == 0:
        return False
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
