"""Stress at particles, at the centres of cells and, averaged, at nodes."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.particle_stress import point_stress
from tissue.fem.fields import StressState
from tissue.models.tooth.grid import HexGrid
from tissue.models.tooth.stiffness import CellStiffness

__all__ = ["cell_stress", "node_average", "particle_stress"]

Array = NDArray[np.float64]


def particle_stress(
    cells: CellStiffness, displacement_m: Array, *, particles: NDArray[np.integer] | None = None
) -> StressState:
    """Stress in the material of particles, by the caller's index; default all.

    Where a cell holds two materials its strain is shared by both, which is first order in the cell's edge.
    """
    chosen = cells.rank if particles is None else cells.rank[particles]
    arrays = [cells.particle_cell_on, cells.place, cells.lame]
    return _evaluate(cells, displacement_m, chosen, arrays)


def cell_stress(cells: CellStiffness, displacement_m: Array) -> StressState:
    """Stress at the centres of cells, in the mean material of their particles; zero where a cell carries nothing."""
    count = cells.grid.cell_count
    weight = cells.volume.numpy() * cells.remaining
    lame = cells.lame.numpy()

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(cells.particle_cell, weights=values, minlength=count), dtype=np.float64)

    weights = np.maximum(total(weight), np.finfo(float).tiny)
    mean = np.stack([total(weight * lame[:, 0]), total(weight * lame[:, 1])], axis=1) / weights[:, None]
    mean[cells.live == 0] = 0.0
    device = cells.device
    arrays: list[Any] = [
        wp.array(np.arange(count), dtype=wp.int32, device=device),
        wp.array(np.full((count, 3), 0.5), dtype=wp.vec3d, device=device),
        wp.array(mean, dtype=wp.float64, device=device),
    ]
    return _evaluate(cells, displacement_m, np.arange(count), arrays)


def node_average(grid: HexGrid, cell_values: Array, weights: Array) -> Array:
    """Mean of cell values, shape (c, k), over the cells around each node, weighted (as by fill); 0 where none is."""
    around = grid.node_cells
    share = np.where(around >= 0, weights[around], 0.0)
    total = share.sum(axis=1)
    values = np.zeros((grid.node_count, cell_values.shape[1]))
    for corner in range(8):
        values += share[:, corner, None] * cell_values[around[:, corner]]
    return np.asarray(values / np.where(total > 0.0, total, 1.0)[:, None])


def _evaluate(cells: CellStiffness, displacement_m: Array, rows: NDArray[np.integer], arrays: list[Any]) -> StressState:
    count, device = len(rows), cells.device
    point: Any = wp.array(rows.astype(np.int32), dtype=wp.int32, device=device)
    cells.displacement.assign(displacement_m)
    inputs = [point, *arrays, cells.cell_nodes_on, cells.displacement, cells.grid.edge_m, 0]
    strain, stress = (wp.empty((count, 6), dtype=wp.float64, device=device) for _ in range(2))
    von_mises = wp.empty(count, dtype=wp.float64, device=device)
    principal = wp.empty(count, dtype=wp.vec3d, device=device)
    outputs = [strain, stress, von_mises, principal]
    cells.run(point_stress, count, inputs, outputs)
    return StressState(strain.numpy(), stress.numpy(), von_mises.numpy(), principal.numpy())
