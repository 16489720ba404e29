"""Stress recovered from particles over a fixed length.

It converges where the stress at a point does not.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from kernels.particle_stiffness import invariants, point_stress
from meshes.base.arrays import Array
from tissue.models.tooth.grid import ParticleSet
from tissue.models.tooth.stiffness import CellStiffness

__all__ = [
    "REACH_M",
    "StressPoints",
    "StressRecovery",
    "ball_weight",
    "particle_stress",
    "stress_invariants",
]


class StressPoints:
    """Points of a material at which the stress is computed repeatedly.

    Parameters
    ----------
    cells
        The cells of the body.
    row
        Rows of the next three arrays, shape (n,).
    cell, place, lame_Pa
        Warp arrays: cell of each row, position in it, 0 to 1 along each edge, and Lame constants
        [Pa], shape (rows, 2).
    """

    def __init__(
        self, cells: CellStiffness, row: NDArray[np.integer], cell: Any, place: Any, lame_Pa: Any
    ) -> None:
        self._cells = cells
        self._count = len(row)
        on: Any = wp.array(row.astype(np.int32), dtype=wp.int32, device=cells.device)
        self._inputs = [
            on,
            cell,
            place,
            lame_Pa,
            cells.cell_nodes_on,
            cells.displacement,
            cells.grid.edge_m,
            0,
        ]
        self._stress = wp.empty((self._count, 6), dtype=wp.float64, device=cells.device)

    def __call__(self, displacement_m: Array) -> Array:
        """Return the stress xx, yy, zz, yz, xz, xy [Pa], shape (n, 6), at nodal displacements [m].

        The next call overwrites it.
        """
        self._cells.displacement.assign(displacement_m)
        self._cells.run(point_stress, self._count, self._inputs, [self._stress])
        return np.asarray(self._stress.numpy())


def particle_stress(
    cells: CellStiffness, displacement_m: Array, *, particles: NDArray[np.integer] | None = None
) -> Array:
    """Return the stress in the material of particles, as `StressPoints` does.

    Particles are given by the caller's index; default all. Where a cell holds two materials, both
    have the strain of the cell, which is first order in the cell's edge.
    """
    rows = cells.rank if particles is None else cells.rank[particles]
    return StressPoints(cells, rows, cells.particle_cell_on, cells.place, cells.lame)(
        displacement_m
    )


def stress_invariants(stress_Pa: Array, *, device: str = "cpu") -> tuple[Array, Array]:
    """Return the von Mises stress and the principal stresses, largest first.

    Stresses of shape (n, 6) give shapes (n,) and (n, 3).
    """
    count = len(stress_Pa)
    given: Any = wp.array(np.ascontiguousarray(stress_Pa), dtype=wp.float64, device=device)
    von_mises = wp.empty(count, dtype=wp.float64, device=device)
    principal = wp.empty(count, dtype=wp.vec3d, device=device)
    wp.launch(
        invariants, dim=count, inputs=[given, 0], outputs=[von_mises, principal], device=device
    )
    return von_mises.numpy(), principal.numpy()


REACH_M = 0.6e-3
"""Radius of the ball over which stress is averaged [m].

It is about the radius of a bur, and the bur's force is spread over this radius too. Next to a cut
the error at cells of 0.3 mm is 6 %, and it decreases with the cells.
"""
CELLS_A_REACH = 2.0
"""Cells in the reach from which on the particles of a cell are averaged.

Their mean stress equals the stress at their centre of mass up to the second order in the cell's
edge. The whole recovery has an error of this order.
"""


def ball_weight(distance_m: Array, reach_m: float) -> Array:
    """Return the weight 1 - (d / R)^2 of points in a ball, 0 outside."""
    return np.asarray(np.maximum(1.0 - (distance_m / reach_m) ** 2, 0.0))


class StressRecovery:
    """Mean stress around points, over the particles of each point's own layer within a fixed reach.

    The weight of a particle is its remaining volume, where its cell carries load, times
    `ball_weight` of its distance. Layers are never mixed, since the stress jumps where the modulus
    does.

    Parameters
    ----------
    particles, cells
        The body.
    place_m, layer
        The points [m], shape (k, 3), and the layer of each, shape (k,).
    reach_m
        Radius of the ball [m]; larger than half the diagonal of the particles' lattice, or a point
        may have no particle in reach.
    """

    def __init__(
        self,
        particles: ParticleSet,
        cells: CellStiffness,
        place_m: Array,
        layer: NDArray[np.integer],
        *,
        reach_m: float = REACH_M,
    ) -> None:
        self._cells = cells
        self._volume = particles.volume_m3[cells.order]
        sorted_layer = particles.layer[cells.order]
        if CELLS_A_REACH * cells.grid.edge_m > reach_m:
            self._group = np.arange(len(sorted_layer))
        else:
            names = int(sorted_layer.max()) + 1
            _, self._group = np.unique(
                cells.particle_cell.astype(np.int64) * names + sorted_layer, return_inverse=True
            )
        whole = self._total(self._volume)

        def mean(values: Array) -> Array:
            return (
                np.stack([self._total(self._volume * each) for each in values.T], axis=1)
                / whole[:, None]
            )

        def on(values: NDArray[Any], dtype: Any) -> Any:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=cells.device)

        at = mean(particles.position_m[cells.order])
        first = np.unique(self._group, return_index=True)[1]
        self._cell = cells.particle_cell[first]
        own_layer = sorted_layer[first]
        self._points = StressPoints(
            cells,
            np.arange(len(at)),
            on(self._cell, wp.int32),
            on(mean(cells.place.numpy()), wp.vec3d),
            on(mean(cells.lame.numpy()), wp.float64),
        )
        rows = []
        columns = []
        weights = []
        for each in np.unique(layer):
            here = np.flatnonzero(layer == each)
            mine = np.flatnonzero(own_layer == each)
            near = cKDTree(place_m[here]).sparse_distance_matrix(
                cKDTree(at[mine]), reach_m, output_type="ndarray"
            )
            rows.append(here[near["i"]])
            columns.append(mine[near["j"]])
            weights.append(ball_weight(near["v"], reach_m).astype(np.float32))
        entries = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
        self._near = csr_matrix(entries, shape=(len(place_m), len(at)))

    def _total(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._group, weights=values))

    def __call__(self, displacement_m: Array) -> Array:
        """Return the mean stress xx, yy, zz, yz, xz, xy [Pa] at nodal displacements [m].

        Its shape is (k, 6). It is NaN where no particle of the layer remains within reach.
        """
        left = self._total(self._volume * self._cells.remaining) * (
            self._cells.live[self._cell] > 0
        )
        share = left / max(float(left.max()), np.finfo(float).tiny)
        weighted = np.empty((len(share), 7), dtype=np.float32)
        weighted[:, :6] = share[:, None] * self._points(displacement_m)
        weighted[:, 6] = share
        total = self._near @ weighted
        found = total[:, 6:] > 0.0
        return np.where(found, total[:, :6] / np.where(found, total[:, 6:], 1.0), np.nan).astype(
            np.float64
        )
