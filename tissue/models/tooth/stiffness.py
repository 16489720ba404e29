"""Stiffness of the cells of a grid, summed over particles that may lose volume."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.cell_strips import LANES, WEIGHTS
from kernels.hexahedra import BLOCKS, cell_products, gather_cells
from kernels.lane_vectors import cube_weights, from_lanes, to_lanes
from kernels.launcher import SplitLaunch, run_once
from kernels.mirror import put
from kernels.particle_stiffness import particle_stiffness
from meshes.base.arrays import Array, Bytes, Flags, Int32s, Integers
from tissue.models.tooth.grid import (
    CORNER_PAIRS,
    CORNERS,
    NO_SPRINGS,
    HexGrid,
    ParticleSet,
    PointSprings,
)
from tissue.models.tooth.strips import LaneVector, StripLayout, StripProduct

AT_CUBE = 1e-6
"""Largest distance of a particle from its regular position that counts as rounding [cell edges]."""


class CellStiffness:
    """Stiffness of every cell, summed over the particles of the cell.

    The sum is computed by :mod:`kernels.particle_stiffness`. A cell is regular if each particle
    lies at the centre of one of eight equal cubes of the cell. For regular cells, the product with
    a vector is computed over strips (groups of eight cells), from weights of the cubes. For other
    cells and for springs, the product is computed cell by cell, from a packed stiffness (without
    its symmetric half).

    Parameters
    ----------
    particles, grid
        The body, and a grid whose cells hold all of its particles.
    inner_strength
        Strength of the stabilisation of cells with few particles. The inner stiffness is the
        stiffness of a full cell minus the stiffness of its centre point. `inner_strength` times the
        inner stiffness is added to a cell with a single particle in its centre. Less is added to a
        cell with more particles.
    springs
        Springs to the ground at points of the cells; default none.
    cores
        Number of processor cores that share kernel launches; default: all cores.

    Attributes
    ----------
    order
        Caller's index of each particle, sorted by cell, shape (p,). ``rank`` is the inverse
        permutation.
    cell_start
        Position of the first particle of each cell in the sorted order, int32, shape (c + 1,).
    particle_cell
        Cell of each particle in the sorted order, int32, shape (p,).
    layout, regular
        Memory layout of the strips, and mask of the regular cells, shape (c,).
    weight, single
        Weights of the regular cells in double and in single precision, Warp arrays, shape (strips,
        WEIGHTS, LANES).
    displacement, force
        Warp arrays of vec3d, shape (n,): factor [m] and result [N] of a product.
    others
        Launches that add the product of the other cells and of their springs to `force`. The list
        is empty if all cells are regular.
    """

    def __init__(
        self,
        particles: ParticleSet,
        grid: HexGrid,
        *,
        inner_strength: float,
        springs: PointSprings = NO_SPRINGS,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self.grid = grid
        self.device = device
        self.cores = cores
        cell, place = grid.locate(particles.position_m)
        self.order = np.argsort(cell, kind="stable")
        self.rank = np.empty_like(self.order)
        self.rank[self.order] = np.arange(len(self.order))
        self.particle_cell = cell[self.order]
        self.cell_start = np.searchsorted(
            self.particle_cell, np.arange(grid.cell_count + 1)
        ).astype(np.int32)

        self.place = put(place[self.order], wp.vec3d, device)
        self.volume = put(particles.volume_m3[self.order], wp.float64, device)
        self.lame = put(particles.lame_Pa[self.order], wp.float64, device)
        self.remaining_on = put(particles.remaining[self.order], wp.uint16, device)
        start = put(self.cell_start, wp.int32, device)
        self._particles = [self.place, self.volume, self.lame, self.remaining_on, start]
        self.cell_nodes_on = put(grid.cell_nodes, wp.int32, device)
        self.node_cells_on = put(grid.node_cells, wp.int32, device)
        self.stiffness = wp.zeros((grid.cell_count, BLOCKS), wp.mat33d, device)
        self.fill_on = wp.zeros(grid.cell_count, wp.float64, device)
        self.live_on = wp.full(grid.cell_count, 1, dtype=wp.uint8, device=device)
        self._inner = put(_inner_stiffness(grid.edge_m), wp.mat33d, device)
        self._strength = float(inner_strength)
        sprung, blocks = springs.by_cell(grid)
        row = np.full(grid.cell_count, -1)
        row[sprung] = np.arange(len(sprung))
        self._springs = [put(row, wp.int32, device), put(blocks, wp.mat33d, device)]
        self.displacement = wp.zeros(grid.node_count, wp.vec3d, device)
        self.force = wp.zeros(grid.node_count, wp.vec3d, device)

        # The cubes have half the cell's edge, so their centres lie at 1/4 and 3/4.
        off = (np.abs(np.abs(place - 0.5) - 0.25) > AT_CUBE).any(axis=1)
        self.regular = np.ones(grid.cell_count, np.bool_)
        self.regular[cell[off]] = False
        self.layout = StripLayout(grid)
        self.slot_on = put(self.layout.slot, wp.int32, device)
        shape = (len(self.layout.base), WEIGHTS, LANES)
        self.weight = wp.zeros(shape, wp.float64, device)
        self.single = wp.zeros(shape, wp.float32, device)
        regular = put(self.regular.astype(np.uint8), wp.uint8, device)
        self._strips = [regular, put(self.layout.strip, wp.vec2i, device)]
        moved = LaneVector(self.layout, wp.float64, device=device)
        lanes = LaneVector(self.layout, wp.float64, device=device)
        count = grid.node_count
        taken = [self.slot_on, self.displacement]
        given = [self.slot_on, lanes.single]
        others = np.flatnonzero(~self.regular)
        of_springs = self.regular[sprung]
        self.others = self._packed_product(others, others, self.stiffness)
        self._product: list[Callable[[], object]] = [
            SplitLaunch(to_lanes, count, taken, [moved.single], cores=cores),
            lanes.single.zero_,
            StripProduct(self.layout, self.weight, moved, lanes, device=device, cores=cores),
            SplitLaunch(from_lanes, count, given, [self.force], cores=cores),
            *self.others,
            *self._packed_product(sprung[of_springs], np.flatnonzero(of_springs), self._springs[1]),
        ]
        self.update(np.arange(grid.cell_count, dtype=np.int32))

    def _packed_product(self, cells: Integers, rows: Integers, stiffness: Any) -> list[SplitLaunch]:
        """Return launches that add the product of some cells to `force`.

        Parameters
        ----------
        cells, rows
            Cells of the product and the row of each cell in ``stiffness``, each of shape (k,).
        stiffness
            Warp array of packed stiffness [N/m], as in :mod:`kernels.hexahedra`.
        """
        if len(cells) == 0:
            return []
        place = np.full(self.grid.cell_count + 1, -1)
        place[cells] = np.arange(len(cells))
        nodes = np.unique(self.grid.cell_nodes[cells])
        corner_force = wp.zeros((len(cells), 8), wp.vec3d, self.device)
        factors = [cells, rows, self.cell_nodes_on, self.live_on, stiffness, self.displacement]
        around = [nodes, place[self.grid.node_cells[nodes]], corner_force]
        return [
            SplitLaunch(cell_products, len(cells), factors, [corner_force], cores=self.cores),
            SplitLaunch(gather_cells, len(nodes), around, [self.force], cores=self.cores),
        ]

    @property
    def remaining(self) -> NDArray[np.uint16]:
        """Remaining fraction of each particle, sorted by cell, in units of 1/65535."""
        return self.remaining_on.numpy()

    @property
    def fill(self) -> Array:
        """Remaining volume of each cell's particles, divided by the volume of the cell."""
        return self.fill_on.numpy()

    @property
    def live(self) -> Bytes:
        """Array with 1 for each cell that carries load, and 0 for other cells."""
        return self.live_on.numpy()

    def set_remaining(self, rows: Integers, steps: NDArray[np.uint16]) -> None:
        """Set the remaining fractions of some particles; `rows` are indices after sorting by cell.

        `update` applies the change to the cells of these particles.
        """
        left = self.remaining
        left[rows] = steps
        if self.device != "cpu":
            self.remaining_on.assign(left)

    def set_live(self, live: Flags) -> None:
        """Set which cells carry load, shape (c,)."""
        changed = np.flatnonzero(self.live != live).astype(np.int32)
        self.live_on.assign(live.astype(np.uint8))
        self._weigh(changed)

    def update(self, cells: Int32s) -> None:
        """Update the stiffness of some cells from the remaining volumes of their particles."""
        if len(cells) == 0:
            return
        size = [self.grid.edge_m, self._strength]
        inputs = [*self._particles, cells, *size, self._inner, *self._springs]
        run_once(particle_stiffness, len(cells), inputs, [self.stiffness, self.fill_on])
        self._weigh(cells)

    def _weigh(self, cells: Int32s) -> None:
        """Update the weights of some cells in their strips."""
        if len(cells) == 0:
            return
        size = [self.grid.edge_m, self._strength]
        inputs = [*self._particles, self.live_on, *self._strips, cells, *size]
        run_once(cube_weights, len(cells), inputs, [self.weight, self.single])

    def product(self, displacement_m: Array) -> Array:
        """Return the nodal forces [N] for nodal displacements [m], without an assembled matrix.

        Forces and displacements have shape (n, 3).
        """
        self.displacement.assign(displacement_m)
        for step in self._product:
            step()
        return np.array(self.force.numpy())

    def cell_matrices(self) -> Array:
        """Return the full stiffness of every cell [N/m], shape (c, 24, 24)."""
        packed = self.stiffness.numpy()
        full = np.zeros((len(packed), 8, 3, 8, 3))
        for block, (a, b) in enumerate(CORNER_PAIRS):
            full[:, a, :, b, :] = packed[:, block]
            full[:, b, :, a, :] = packed[:, block].transpose(0, 2, 1)
        return full.reshape(-1, 24, 24)


def full_cell_stiffness(
    edge_m: float, points: Array, weights: Array, *, first_Pa: float, shear_Pa: float
) -> Array:
    """Return the stiffness of a cell [N/m], shape (24, 24).

    The stiffness is the weighted sum of B^T D B at points of the cell. The function uses only
    NumPy.

    Parameters
    ----------
    edge_m
        Edge of the cell [m].
    points
        Positions in the cell, 0 to 1 along each edge, shape (p, 3).
    weights
        Volume of each point [m3], shape (p,).
    first_Pa, shear_Pa
        Lame constants lambda and mu [Pa].
    """
    elasticity = np.diag([2.0 * shear_Pa] * 3 + [shear_Pa] * 3)
    elasticity[:3, :3] += first_Pa
    total = np.zeros((24, 24))
    for point, weight in zip(points, weights, strict=True):
        strain = strain_matrix(point, edge_m)
        total += weight * strain.T @ elasticity @ strain
    return total


def strain_matrix(place: Array, edge_m: float) -> Array:
    """Return the strain matrix B at a position in a cell [1/m], shape (6, 24).

    B converts the 24 nodal displacements to the strains xx, yy, zz, yz, xz, xy (engineering shear).
    """
    factors = np.where(CORNERS == 1, place, 1.0 - place)
    signs = np.where(CORNERS == 1, 1.0, -1.0) / edge_m
    strain = np.zeros((6, 8, 3))
    for a in range(8):
        x, y, z = (
            signs[a, i] * factors[a, (i + 1) % 3] * factors[a, (i + 2) % 3] for i in range(3)
        )
        strain[:, a, :] = [[x, 0, 0], [0, y, 0], [0, 0, z], [0, z, y], [z, 0, x], [y, x, 0]]
    return strain.reshape(6, 24)


def _inner_stiffness(edge_m: float) -> Array:
    """Return the stiffness of a full cell minus the stiffness of its centre point, in packed form.

    The Lame constants are set to 1. The shape is (36, 3, 3).
    """
    gauss = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
    volume = edge_m**3
    full = full_cell_stiffness(edge_m, gauss, np.full(8, volume / 8.0), first_Pa=1.0, shear_Pa=1.0)
    centre = full_cell_stiffness(
        edge_m, np.full((1, 3), 0.5), np.array([volume]), first_Pa=1.0, shear_Pa=1.0
    )
    blocks = (full - centre).reshape(8, 3, 8, 3)
    return np.stack([blocks[a, :, b, :] for a, b in CORNER_PAIRS])
