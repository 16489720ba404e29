"""Stress at particles, and the von Mises and principal stresses of any."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.particle_stress import invariants, point_stress
from meshes.base.arrays import Array
from tissue.models.tooth.stiffness import CellStiffness

__all__ = ["particle_stress", "stress_invariants"]


def particle_stress(
    cells: CellStiffness, displacement_m: Array, *, particles: NDArray[np.integer] | None = None
) -> Array:
    """Stress xx, yy, zz, yz, xz, xy [Pa] in the material of particles, by the caller's index, default all; (n, 6).

    Where a cell holds two materials its strain is shared by both, which is first order in the cell's edge.
    """
    rows = cells.rank if particles is None else cells.rank[particles]
    point: Any = wp.array(rows.astype(np.int32), dtype=wp.int32, device=cells.device)
    cells.displacement.assign(displacement_m)
    inputs = [
        point, cells.particle_cell_on, cells.place, cells.lame, cells.cell_nodes_on, cells.displacement,
        cells.grid.edge_m, 0,
    ]  # fmt: skip
    stress = wp.empty((len(rows), 6), dtype=wp.float64, device=cells.device)
    cells.run(point_stress, len(rows), inputs, [stress])
    return np.asarray(stress.numpy())


def stress_invariants(stress_Pa: Array, *, device: str = "cpu") -> tuple[Array, Array]:
    """Von Mises stress, shape (n,), and principal stresses, largest first, shape (n, 3), of stresses, shape (n, 6)."""
    count = len(stress_Pa)
    given: Any = wp.array(np.ascontiguousarray(stress_Pa), dtype=wp.float64, device=device)
    von_mises = wp.empty(count, dtype=wp.float64, device=device)
    principal = wp.empty(count, dtype=wp.vec3d, device=device)
    wp.launch(invariants, dim=count, inputs=[given, 0], outputs=[von_mises, principal], device=device)
    return von_mises.numpy(), principal.numpy()
