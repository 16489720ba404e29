"""Elastic body of particles in a grid of finite elements, updated when material is removed."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from meshes.base.arrays import Array, Flags, Int32s, Integers, Ints
from tissue.fem.conjugate_gradients import (
    Iterate,
    Solution,
    SolverOutcome,
    conjugate_gradients,
    dot,
)
from tissue.fem.solvers.held_body import rigid_modes
from tissue.models.tooth.grid import (
    FULL_STEPS,
    NO_SPRINGS,
    HexGrid,
    NodeSupports,
    ParticleSet,
    PointSprings,
    ball_weight,
    shape_values,
)
from tissue.models.tooth.multigrid import GridHierarchy
from tissue.models.tooth.stiffness import CellStiffness

LEAST_CURVATURE = 1e-12
"""Ratio of ``p . K p`` to ``p . D p`` below which ``p . K p`` is a rounding error.

K is the stiffness, D its diagonal and p a displacement. Below this ratio, p counts as a motion
without resistance. For a tooth of 1e5 nodes in a ligament a million times softer than the tooth,
the smallest ratio of ``p . K p`` to ``p . D p`` is 1e-8.
"""


LEAST_RESTRAINT = 1e-9
"""Ratio of eigenvalues below which the supports of a part do not prevent every rigid motion.

The ratio is the smallest eigenvalue divided by the largest eigenvalue of the stiffness against
rigid motions. Rounding errors give a ratio of 1e-16. A part that is held at three corners of a cell
has a ratio of 1e-2.
"""


def supported_cells(
    grid: HexGrid,
    filled: Flags,
    supports: NodeSupports,
    springs: PointSprings,
    springs_cell: Int32s,
) -> Flags:
    """Return a mask of the cells that the supports hold against all six rigid motions.

    ``filled`` is a mask of the cells with material, shape (c,). ``springs_cell`` holds the cell of
    each spring. Filled cells that are connected by faces form a part. A part is supported if its
    supports, together with nodes shared with other supported parts, prevent every rigid motion. A
    part that is connected to the rest only by one node or one edge is not supported. The part would
    rotate freely about this node or edge, and the stiffness would be singular.
    """
    at = tuple(grid.cell_place.T)
    box = np.zeros(grid.cell_place.max(axis=0) + 1, np.bool_)
    box[at] = filled
    numbered, count = label(box)
    part_of = numbered[at] - 1
    held = supports.fixed.copy()
    on_part = np.where(springs_cell >= 0, part_of[springs_cell], -1)
    supported = np.zeros(count, np.bool_)
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


def _members(grid: HexGrid, part_of: Integers, count: int) -> list[Ints]:
    """Return the nodes of each part, a set of cells that are connected by faces."""
    cells = np.argsort(part_of, kind="stable")
    starts = np.searchsorted(part_of[cells], np.arange(count + 1))
    members = []
    inside = np.zeros(grid.node_count, np.bool_)
    for a, b in pairwise(starts):
        inside[:] = False
        inside[grid.cell_nodes[cells[a:b]]] = True
        members.append(np.flatnonzero(inside))
    return members


def _restrained(grid: HexGrid, nodes: Integers, held: Flags, springs: PointSprings) -> bool:
    """Return True if held nodes and springs together prevent every rigid motion."""
    some = nodes[held[nodes].any(axis=1)]
    if len(some) + len(springs.position_m) == 0:
        return False
    place = grid.node_place[some].astype(np.float64)
    sprung = (springs.position_m - grid.origin_m) / grid.edge_m
    centre = np.concatenate([place, sprung]).mean(axis=0)
    place -= centre
    restraint = springs.restraint(grid.origin_m + grid.edge_m * centre, grid.edge_m)
    restraint /= max(np.trace(restraint[:3, :3]), np.finfo(float).tiny)
    rows = rigid_modes(place, np.zeros(3))[held[some]]
    restraint += rows.T @ rows
    values = np.linalg.eigvalsh(restraint)
    return bool(values[0] > LEAST_RESTRAINT * values[-1])


INNER_STRENGTH = 0.1
"""Relative strength of the stabilisation of cells with few particles.

With smaller values, some cells have a singular stiffness. The error of the solution is close to the
error without stabilisation (table in test_tooth_sphere.py).
"""
LEAST_FILL = 1e-3
"""Filled fraction below which a cell is treated as if it carried no load.

The stiffness of such a cell is smaller than the change of stiffness when one particle is shifted.
"""
MORE_ITERATIONS = 1.5
"""Ratio of numbers of iterations above which the coarsest grid is factorised again.

The ratio is the present number of iterations divided by the number at the last factorisation. The
value is chosen. In the molar scene with cells of 0.6 mm, 25 solutions take 58 iterations in total
for any value from 1 to 3.
"""
TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Change:
    """Result of a stiffness update.

    Attributes
    ----------
    cells
        Indices of the cells whose stiffness changed, shape (k,).
    debris
        Indices of the particles that have lost their connection to a support, shape (d,). The
        indices refer to the caller's order of particles.
    """

    cells: Int32s
    debris: Ints


class ParticleBody:
    """Elastic body made of particles, for small strains and quasi-static loads.

    Parameters
    ----------
    particles
        Particles of the body.
    grid
        Grid, from :meth:`HexGrid.around`, whose cells together hold all particles.
    supports, springs
        Supports of the grid's nodes, and springs that connect points in the grid's cells to the
        ground. A spring is removed together with the cell that holds its point.
    inner_strength
        Stabilisation of cells with few particles, see :mod:`kernels.particle_stiffness`; 0 switches
        it off.
    device, cores
        Warp device, and number of processor cores that share kernel launches (default: all cores).
        The results are bitwise equal for any number of cores.

    Attributes
    ----------
    cells
        Stiffness of the cells.
    carrying
        Mask of the nodes of cells that carry load, shape (n,).
    displacement_m
        Last solution for the displacement [m], shape (n, 3). The next solution starts from it.
    """

    def __init__(
        self,
        particles: ParticleSet,
        grid: HexGrid,
        supports: NodeSupports,
        *,
        springs: PointSprings = NO_SPRINGS,
        inner_strength: float = INNER_STRENGTH,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self.particles = particles
        self.grid = grid
        self.supports = supports
        self.springs = springs
        self.cells = CellStiffness(
            particles,
            grid,
            inner_strength=inner_strength,
            springs=self.springs,
            device=device,
            cores=cores,
        )
        self.displacement_m = supports.displacement_m.copy()
        self._hierarchy = GridHierarchy(self.cells, supports)
        self._tree = cKDTree(particles.position_m)
        self._springs_cell = grid.locate(self.springs.position_m)[0]
        self._touched = np.zeros(grid.cell_count, np.bool_)
        self._filled = np.zeros(grid.cell_count, np.bool_)
        self._is_debris = np.zeros(grid.cell_count, np.bool_)
        self._iterations_fresh = 0
        self.carrying = np.zeros(grid.node_count, np.bool_)
        self._apply(np.arange(grid.cell_count, dtype=np.int32))

    @property
    def debris(self) -> Ints:
        """Indices, in the caller's order, of the unsupported particles that still have volume."""
        return self._particles_in(self._is_debris)

    def set_remaining(self, particles: Integers, steps: Integers) -> None:
        """Set the remaining volume fractions of some particles, in units of 1/65535.

        ``particles`` are indices into the particles in the order in which the caller passed them.
        `update` applies the change to the stiffness.
        """
        rows = self.cells.rank[particles]
        left = self.cells.remaining
        changed = left[rows] != steps
        self.cells.set_remaining(rows[changed], np.asarray(steps)[changed].astype(np.uint16))
        self._touched[self.cells.particle_cell[rows[changed]]] = True

    def update(self) -> Change:
        """Update stiffness, unsupported cells and preconditioner after particles have lost volume.

        The stiffness is computed again only for cells with changed particles.
        """
        touched = np.flatnonzero(self._touched).astype(np.int32)
        self._touched[touched] = False
        self.cells.update(touched)
        return self._apply(touched)

    def _apply(self, touched: Int32s) -> Change:
        before = self.cells.live.copy()
        was_debris = self._is_debris
        filled = self.cells.fill >= LEAST_FILL
        if (filled != self._filled).any():
            live = supported_cells(
                self.grid, filled, self.supports, self.springs, self._springs_cell
            )
            self._filled = filled
            self.cells.set_live(live)
            # A cell with too little material to carry load, next to a cell that carries load, is
            # not debris: its neighbour holds it.
            borders = np.zeros_like(live)
            pairs = self.grid.face_pairs
            borders[pairs[live[pairs[:, 0]], 1]] = True
            borders[pairs[live[pairs[:, 1]], 0]] = True
            self._is_debris = ~live & (filled | ~borders)
        cells = np.union1d(touched, np.flatnonzero(before != self.cells.live)).astype(np.int32)
        if len(cells):
            self._hierarchy.update(cells)
            self.carrying = np.zeros(self.grid.node_count, np.bool_)
            self.carrying[self.grid.cell_nodes[self.cells.live > 0]] = True
            self._free = (~self.supports.fixed & self.carrying[:, None]).astype(np.float64)
            self._diagonal = self._hierarchy.finest.diagonal.numpy()
        return Change(cells, self._particles_in(self._is_debris & ~was_debris))

    def _particles_in(self, cells: Flags) -> Ints:
        """Return the indices, in the caller's order, of the remaining particles of some cells."""
        if not cells.any():
            return np.zeros(0, np.int64)
        return np.sort(
            self.cells.order[cells[self.cells.particle_cell] & (self.cells.remaining > 0)]
        )

    def spread(self, point_m: Array, force_N: Array) -> Array:
        """Return nodal forces [N], shape (n, 3), that represent forces at points.

        Each force acts on the cell that holds its point. If this cell carries no load, or if no
        cell holds the point, the force acts on the nearest cell that carries load.

        Parameters
        ----------
        point_m
            A point, shape (3,), or points, shape (k, 3) [m].
        force_N
            Force at each point [N], with the same shape as `point_m`.
        """
        live = np.flatnonzero(self.cells.live)
        points = np.atleast_2d(point_m)
        forces = np.atleast_2d(force_N)
        cell, _ = self.grid.locate(points)
        off = (cell < 0) | (self.cells.live[cell] == 0)
        if len(live) == 0:
            return np.zeros((self.grid.node_count, 3))
        # If a cut has emptied the cell, or the point lies in air, use the nearest cell that carries
        # load.
        if off.any():
            cell[off] = live[cKDTree(self.grid.cell_centre_m[live]).query(points[off])[1]]
        place = np.clip(
            (points - self.grid.origin_m) / self.grid.edge_m - self.grid.cell_place[cell], 0.0, 1.0
        )
        corner = self.grid.cell_nodes[cell].ravel()
        shares = shape_values(place)[:, :, None] * forces[:, None, :]
        count = self.grid.node_count
        load = [
            np.bincount(corner, weights=shares[:, :, axis].ravel(), minlength=count)
            for axis in range(3)
        ]
        return np.stack(load, axis=1)

    def spread_over(self, point_m: Array, force_N: Array, *, radius_m: float) -> Array:
        """Return nodal forces [N], shape (n, 3), that represent a force spread around a point.

        The force is spread over the particles within a radius of the point. The share of a particle
        is proportional to its remaining volume times its `ball_weight`. When the cells are refined,
        the stress of such a force converges, whereas the stress of a point force increases without
        bound. If no remaining particle lies within the radius, the force acts at the point.
        """
        near = np.array(self._tree.query_ball_point(point_m, radius_m), np.int64)
        near = near[self.cells.live[self.cells.particle_cell[self.cells.rank[near]]] > 0]
        left = self.cells.remaining[self.cells.rank[near]] / FULL_STEPS
        away = np.linalg.norm(self.particles.position_m[near] - point_m, axis=1)
        weight = self.particles.volume_m3[near] * left * ball_weight(away, radius_m)
        # There is no particle within the radius, or all of them are removed.
        if not weight.sum() > 0.0:
            return self.spread(point_m, force_N)
        return self.spread(
            self.particles.position_m[near], (weight / weight.sum())[:, None] * force_N
        )

    def product(self, displacement_m: Array) -> Array:
        """Return nodal forces [N] for nodal displacements [m], each of shape (n, 3).

        The forces of the springs are included. The forces of the supports are not included.
        """
        return self.cells.product(displacement_m)

    def solve(
        self,
        load_N: Array,
        *,
        tolerance: float = TOLERANCE,
        limit: int = 200,
        cold: bool = False,
        start_m: Array | None = None,
    ) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3).

        The energy norm of the solution is ``sqrt(u . f)``. The energy norm of the error is
        estimated as the larger of two values. The first value is ``sqrt(r . B r)``, with the
        residual r and the preconditioner B. The second value is ``sqrt(r . D^-1 r / 24)``, with the
        diagonal D of the stiffness K. The second value is a lower bound of the error, because the
        24 eigenvalues of ``D^-1 K`` of a cell are not negative and their sum is 24. The first value
        misses a load along a motion without resistance, because the preconditioner ignores this
        motion. The second value detects such a load.

        Parameters
        ----------
        load_N
            Forces at the nodes [N], shape (n, 3). Forces along displacement components that a
            support holds are carried by the support.
        tolerance
            Allowed relative error in the energy norm. The relative error of the stress, averaged
            over the whole body, is about as large.
        limit
            Largest number of iterations.
        cold
            True to start the iterations from zero instead of the last solution.
        start_m
            Displacement [m] from which the iterations start instead of the last solution, shape (n,
            3).
        """
        held = self.supports.displacement_m
        lost = (load_N != 0.0) & ~self.carrying[:, None] & ~self.supports.fixed
        if not self.cells.live.any() or lost.any():
            return Solution(held.copy(), SolverOutcome.UNSUPPORTED, 0, residual=1.0, error=np.inf)
        load = (load_N - self.product(held) if held.any() else load_N) * self._free
        guess = held if cold else self.displacement_m if start_m is None else start_m
        if self._iterations_fresh == 0:
            self._hierarchy.refresh()
        diagonal = self._diagonal
        by_diagonal = np.divide(
            1.0 / 24.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0
        )

        def error(now: Iterate) -> float:
            energy = dot(now.found, load)
            size = max(now.slopes[-1], dot(now.residual, now.residual * by_diagonal))
            return float(np.sqrt(size / energy)) if energy > 0.0 else np.inf

        found = conjugate_gradients(
            lambda u: self.product(u) * self._free,
            load,
            precondition=lambda residual: self._hierarchy(residual) * self._free,
            error=error,
            tolerance=tolerance,
            limit=limit,
            start=(guess - held) * self._free,
            least_curvature=lambda step: LEAST_CURVATURE * dot(step, diagonal * step),
            correct_last=True,
        )
        if (
            self._iterations_fresh == 0
            or found.iterations > MORE_ITERATIONS * self._iterations_fresh
        ):
            self._hierarchy.refresh()
            self._iterations_fresh = max(found.iterations, 1)
        moved = found.displacement_m + held
        if found.converged:
            self.displacement_m = moved
        return replace(found, displacement_m=moved)

    def matrix(self) -> csr_matrix:
        """Return the assembled stiffness [N/m], shape (3 n, 3 n).

        The matrix includes the springs. Rows and columns of held components are empty.
        """
        live = self.cells.live > 0
        unknown = (3 * self.grid.cell_nodes[live][:, :, None] + np.arange(3)).reshape(-1, 24)
        rows, columns = np.broadcast_arrays(unknown[:, :, None], unknown[:, None, :])
        free = (~self.supports.fixed).ravel().astype(np.float64)
        values = self.cells.cell_matrices()[live] * free[rows] * free[columns]
        entries = (values.ravel(), (rows.ravel(), columns.ravel()))
        return csr_matrix(entries, shape=(3 * self.grid.node_count,) * 2)
