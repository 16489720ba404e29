"""Stress at particles, and the von Mises and principal stresses of any."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.particle_stress import invariants, point_stress
from meshes.base.arrays import Array
from tissue.models.tooth.stiffness import CellStiffness

__all__ = ["StressPoints", "particle_stress", "stress_invariants"]


class StressPoints:
    """Points of a material at which the stress can be had again and again.

    Parameters
    ----------
    cells
        The cells of the body.
    row
        Rows of the next three arrays, shape (n,).
    cell, place, lame_Pa
        Warp arrays: cell of each row, place in it, 0 to 1 along each edge, and Lame constants [Pa], shape (rows, 2).
    """

    def __init__(self, cells: CellStiffness, row: NDArray[np.integer], cell: Any, place: Any, lame_Pa: Any) -> None:
        self._cells, self._count = cells, len(row)
        on: Any = wp.array(row.astype(np.int32), dtype=wp.int32, device=cells.device)
        self._inputs = [on, cell, place, lame_Pa, cells.cell_nodes_on, cells.displacement, cells.grid.edge_m, 0]
        self._stress = wp.empty((self._count, 6), dtype=wp.float64, device=cells.device)

    def __call__(self, displacement_m: Array) -> Array:
        """Stress xx, yy, zz, yz, xz, xy [Pa], shape (n, 6), at nodal displacements [m]; the next call overwrites it."""
        self._cells.displacement.assign(displacement_m)
        self._cells.run(point_stress, self._count, self._inputs, [self._stress])
        return np.asarray(self._stress.numpy())


def particle_stress(
    cells: CellStiffness, displacement_m: Array, *, particles: NDArray[np.integer] | None = None
) -> Array:
    """Stress in the material of particles, by the caller's index, default all; as of `StressPoints`.

    Where a cell holds two materials its strain is shared by both, which is first order in the cell's edge.
    """
    rows = cells.rank if particles is None else cells.rank[particles]
    return StressPoints(cells, rows, cells.particle_cell_on, cells.place, cells.lame)(displacement_m)


def stress_invariants(stress_Pa: Array, *, device: str = "cpu") -> tuple[Array, Array]:
    """Von Mises stress, shape (n,), and principal stresses, largest first, shape (n, 3), of stresses, shape (n, 6)."""
    count = len(stress_Pa)
    given: Any = wp.array(np.ascontiguousarray(stress_Pa), dtype=wp.float64, device=device)
    von_mises = wp.empty(count, dtype=wp.float64, device=device)
    principal = wp.empty(count, dtype=wp.vec3d, device=device)
    wp.launch(invariants, dim=count, inputs=[given, 0], outputs=[von_mises, principal], device=device)
    return von_mises.numpy(), principal.numpy()
