"""Recovered stress, compliance of the supports, and first guesses of solves.

Stress is averaged over particles within a fixed length. It converges where the stress at a point
does not.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from kernels.mirror import put
from kernels.particle_stiffness import invariants, point_stress
from meshes.base.arrays import Array, Integers
from tissue.fem.conjugate_gradients import Solution, dot
from tissue.fem.solvers.held_body import rigid_modes
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import ParticleSet, ball_weight
from tissue.models.tooth.stiffness import CellStiffness

__all__ = [
    "REACH_M",
    "FirstGuess",
    "StressPoints",
    "StressRecovery",
    "SupportCompliance",
    "stress_invariants",
    "support_compliance",
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
        self, cells: CellStiffness, row: Integers, cell: Any, place: Any, lame_Pa: Any
    ) -> None:
        self._cells = cells
        self._count = len(row)
        on = put(row.astype(np.int32), wp.int32, cells.device)
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
        self._stress = wp.empty((self._count, 6), wp.float64, cells.device)

    def __call__(self, displacement_m: Array) -> Array:
        """Return the stress xx, yy, zz, yz, xz, xy [Pa], shape (n, 6), at nodal displacements [m].

        The next call overwrites it.
        """
        self._cells.displacement.assign(displacement_m)
        self._cells.run(point_stress, self._count, self._inputs, [self._stress])
        return np.asarray(self._stress.numpy())


def stress_invariants(stress_Pa: Array, *, device: str = "cpu") -> tuple[Array, Array]:
    """Return the von Mises stress and the principal stresses, largest first.

    Stresses of shape (n, 6) give shapes (n,) and (n, 3).
    """
    count = len(stress_Pa)
    given = put(stress_Pa, wp.float64, device)
    von_mises = wp.empty(count, wp.float64, device)
    principal = wp.empty(count, wp.vec3d, device)
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
        layer: Integers,
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

        at = mean(particles.position_m[cells.order])
        first = np.unique(self._group, return_index=True)[1]
        self._cell = cells.particle_cell[first]
        own_layer = sorted_layer[first]
        self._points = StressPoints(
            cells,
            np.arange(len(at)),
            put(self._cell, wp.int32, cells.device),
            put(mean(cells.place.numpy()), wp.vec3d, cells.device),
            put(mean(cells.lame.numpy()), wp.float64, cells.device),
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
        weighted = np.empty((len(share), 7), np.float32)
        weighted[:, :6] = share[:, None] * self._points(displacement_m)
        weighted[:, 6] = share
        total = self._near @ weighted
        found = total[:, 6:] > 0.0
        return np.where(found, total[:, :6] / np.where(found, total[:, 6:], 1.0), np.nan).astype(
            np.float64
        )


@dataclass(frozen=True, eq=False)
class SupportCompliance:
    """Rigid motion of a part of a body for a wrench on it, both about a reference point.

    Attributes
    ----------
    matrix
        Translation [m] and rotation [rad] for force [N] and torque [N m], symmetric positive
        definite, shape (6, 6).
    reference_m
        The reference point [m], shape (3,).
    solutions
        The six solves; if any has not converged the matrix must not be used.
    loads_N
        Nodal forces of each [N], shape (n, 3).
    asymmetry
        Largest difference of the matrix from its transpose before it was made symmetric, relative
        to the geometric mean of the two diagonal entries.
    """

    matrix: Array
    reference_m: Array
    solutions: tuple[Solution, ...]
    loads_N: tuple[Array, ...]
    asymmetry: float

    @property
    def converged(self) -> bool:
        """True if all solves converged, so that the matrix may be used."""
        return all(solution.converged for solution in self.solutions)


def support_compliance(
    body: ParticleBody,
    *,
    weights: Array,
    reference_m: Array,
    tolerance: float = 1e-4,
    start: SupportCompliance | None = None,
) -> SupportCompliance:
    """Return the compliance of the part of a body where ``weights``, shape (n,), are not zero.

    The wrench is spread over the nodes as ``f = w R G^-1 q``. The rigid motion is the weighted
    least-squares fit ``G^-1 sum w R^T u``, with R the unit rigid motions and ``G = sum w R^T R``.
    The fit is the transpose of the spread, so the matrix is symmetric for any weights.

    Parameters
    ----------
    body
        The body, with its supports.
    weights
        Weight of each node, such as the volume of stiff material around it.
    reference_m
        Reference point of torque and rotation [m], shape (3,).
    tolerance
        Relative error in the energy norm of each solve.
    start
        An earlier result whose displacements the solves start from.
    """
    used = np.where(body.carrying, weights, 0.0)
    motions = rigid_modes(body.grid.node_position_m, reference_m)
    weighted = used[:, None, None] * motions
    gram = np.einsum("nik,nil->kl", weighted, motions)
    spread = np.einsum("nik,kl->nil", weighted, np.linalg.inv(gram))
    solutions: list[Solution] = []
    loads = [spread[:, :, column].copy() for column in range(6)]
    matrix = np.zeros((6, 6))
    kept = body.displacement_m
    for column in range(6):
        guess = None if start is None else start.solutions[column].displacement_m
        found = body.solve(loads[column], tolerance=tolerance, cold=start is None, start_m=guess)
        matrix[:, column] = np.einsum("nik,ni->k", spread, found.displacement_m)
        solutions.append(found)
    body.displacement_m = kept
    # Entries have different units, so that each is compared with the diagonal.
    size = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    asymmetry = float((np.abs(matrix - matrix.T) / np.where(size > 0.0, size, 1.0)).max())
    return SupportCompliance(
        0.5 * (matrix + matrix.T), reference_m, tuple(solutions), tuple(loads), asymmetry
    )


NULL_CUT = 1e-6
"""Relative cut of the scaled eigenvalues of the energies between solutions.

Eigenvalues below this share of the largest are errors of the solves.
"""


class FirstGuess:
    """Combination of earlier solutions that is closest, in energy, to the solution for a new load.

    With solutions u_i for loads f_i it solves ``(u_i . f_j) c_j = u_i . f``. The known part of a
    force that has grown, turned or moved then costs no iterations. If the body has changed since,
    the guess is a little worse.

    Parameters
    ----------
    kept
        Solutions that are always kept, shape (n, 3) each, and the load of each: the six of the
        support compliance.
    recent
        Number of latest solutions that are kept in addition. While a body is cut, two leave 3
        iterations and six leave 5, since the older ones belong to a fuller body.
    """

    def __init__(self, kept: list[tuple[Array, Array]], *, recent: int = 2) -> None:
        self._solutions = [moved.ravel() for moved, _ in kept]
        self._loads = [load.ravel() for _, load in kept]
        self._first = len(kept)
        self._most = len(kept) + recent
        self._energy = np.array(
            [[dot(u, f) for f in self._loads] for u in self._solutions]
        ).reshape(len(kept), len(kept))

    def add(self, displacement_m: Array, load_N: Array) -> None:
        """Store a solution and its load [m], [N], shape (n, 3), in place of the oldest."""
        if not load_N.any():
            return
        if len(self._solutions) == self._most:
            del self._solutions[self._first], self._loads[self._first]
            self._energy = np.delete(
                np.delete(self._energy, self._first, axis=0), self._first, axis=1
            )
        moved = displacement_m.ravel().copy()
        load = load_N.ravel().copy()
        self._solutions.append(moved)
        self._loads.append(load)
        column = np.array(
            [
                # Equal for exact solutions: the mean keeps the matrix symmetric.
                0.5 * (dot(u, load) + dot(moved, f))
                for u, f in zip(self._solutions, self._loads, strict=True)
            ]
        )
        self._energy = np.block(
            [[self._energy, column[:-1, None]], [column[None, :-1], column[-1:, None]]]
        )

    def __call__(self, load_N: Array) -> Array:
        """Return a guess of the displacement [m] for a load [N], shapes (n, 3)."""
        guess = np.zeros(load_N.size)
        load = load_N.ravel()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._energy), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(
            scale[:, None] * 0.5 * (self._energy + self._energy.T) * scale
        )
        if values.size and values[-1] > 0.0:
            modes = (scale[:, None] * vectors)[:, values > NULL_CUT * values[-1]]
            work = np.array([dot(u, load) for u in self._solutions])
            share = modes @ ((modes.T @ work) / values[values > NULL_CUT * values[-1]])
            for moved, each in zip(self._solutions, share, strict=True):
                guess += each * moved
        return guess.reshape(load_N.shape)
