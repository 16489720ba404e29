"""Stiffness of the cells of a grid, summed over particles that may lose volume."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.hexahedra import BLOCKS
from kernels.launcher import run_once
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
from tissue.models.tooth.strips import CellStrips, PackedProduct

CENTRE = np.full(3, 0.5)


class CellStiffness:
    """Stiffness of every cell in packed form, summed over the particles of the cell.

    The sum is computed by :mod:`kernels.particle_stiffness`.

    Parameters
    ----------
    particles, grid
        The body, and a grid whose cells hold all of its particles.
    inner_strength
        Strength of the stabilisation of cells with few particles. Inner stiffness is the stiffness
        of a full cell minus the stiffness of its centre point. This fraction of the inner stiffness
        is added to a cell with a single particle in its centre. Less is added to a cell with more
        particles.
    springs
        Springs to the ground at points of the cells; default none.
    cores
        Number of processor cores that share kernel launches; default: all cores.

    Attributes
    ----------
    order
        Caller's index of each particle, in the order sorted by cell, shape (p,). ``rank`` is the
        inverse permutation.
    cell_start
        Position of the first particle of each cell in the sorted order, int32, shape (c + 1,).
    particle_cell
        Cell of each particle in the sorted order, int32, shape (p,).
    strips
        Product of cells in strips (groups of eight cells), without springs. Cells with irregular
        particles are not in strips.
    others
        Product of ``displacement`` with the stiffness of the cells that are not in strips,
        including the springs of these cells. None if all cells are in strips. A call adds the
        product to ``force``. ``displacement`` and ``force`` are Warp arrays of vec3d, shape (n,).
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
        self._inner = put(_packed(_inner_stiffness(grid.edge_m)), wp.mat33d, device)
        self._strength = float(inner_strength)
        sprung, blocks = springs.by_cell(grid)
        row = np.full(grid.cell_count, -1)
        row[sprung] = np.arange(len(sprung))
        self._springs = [put(row, wp.int32, device), put(blocks, wp.mat33d, device)]
        self.displacement = wp.zeros(grid.node_count, wp.vec3d, device)
        self.force = wp.zeros(grid.node_count, wp.vec3d, device)
        self.strips = CellStrips(
            grid,
            place[self.order],
            self.particle_cell,
            vector=self.displacement,
            force=self.force,
            cores=cores,
        )
        regular = self.strips.regular
        others = np.flatnonzero(~regular)
        of_springs = regular[sprung]

        def packed(cells: Integers, rows: Integers, blocks: Any) -> PackedProduct | None:
            """Return the product of some cells with the displacement; None without cells."""
            if len(cells) == 0:
                return None
            return PackedProduct(
                grid,
                cells,
                rows,
                blocks,
                live=self.live_on,
                vector=self.displacement,
                force=self.force,
                cores=cores,
            )

        self.others = packed(others, others, self.stiffness)
        self._sprung = packed(sprung[of_springs], np.flatnonzero(of_springs), self._springs[1])
        self.update(np.arange(grid.cell_count, dtype=np.int32))

    @property
    def remaining(self) -> NDArray[np.uint16]:
        """Remaining fraction of each particle in the sorted order, in steps of 1/65535."""
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
        """Set the remaining fractions of particles, given by their rows in the sorted order.

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
        if len(cells):
            self.strips.update(
                self._particles,
                self.live_on,
                cells,
                edge_m=self.grid.edge_m,
                strength=self._strength,
            )

    def product(self, displacement_m: Array) -> Array:
        """Return the nodal forces [N] for nodal displacements [m], without an assembled matrix.

        Forces and displacements have shape (n, 3).
        """
        self.displacement.assign(displacement_m)
        self.strips.product()
        for each in (self.others, self._sprung):
            if each is not None:
                each()
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
    """Return the stiffness of a full cell minus the stiffness of its centre point, shape (24, 24).

    The Lame constants are set to 1.
    """
    gauss = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
    volume = edge_m**3
    full = full_cell_stiffness(edge_m, gauss, np.full(8, volume / 8.0), first_Pa=1.0, shear_Pa=1.0)
    centre = full_cell_stiffness(
        edge_m, CENTRE[None], np.array([volume]), first_Pa=1.0, shear_Pa=1.0
    )
    return full - centre


def _packed(matrix: Array) -> Array:
    blocks = matrix.reshape(8, 3, 8, 3)
    return np.stack([blocks[a, :, b, :] for a, b in CORNER_PAIRS])
