"""Multigrid preconditioner whose grids double the cell edge, with exact Galerkin projection.

After a change of a few cells, only the few coarse cells that contain these cells are computed
again. All grids therefore always represent the present body. One symmetric V-cycle in single
precision is the preconditioner of conjugate gradients. On the finest grid, which has no assembled
rows, the smoother is a Chebyshev polynomial. On the coarser grids the smoother is Gauss-Seidel over
eight colours of nodes. After the correction by the next coarser grid, the colours are visited in
reverse order. (Trottenberg, Oosterlee, Schueller 2001, Multigrid, ch. 2.)
"""

from functools import partial

import numpy as np
import warp as wp
from scipy.sparse import bsr_matrix

from kernels.grid_transfer import (
    assemble_rows,
    coarse_stiffness,
    first_residuals,
    interpolate,
    restrict,
    sweep_colour,
)
from kernels.hexahedra import BLOCKS
from kernels.launcher import SplitLaunch, run_once
from kernels.mirror import put
from meshes.base.arrays import Array, Int32s
from tissue.models.tooth.finest_level import FinestLevel
from tissue.models.tooth.grid import CORNERS, NEIGHBOURS, HexGrid, NodeSupports
from tissue.models.tooth.stiffness import CellStiffness

COARSEST_NODES = 300
"""Largest number of nodes of a grid that is solved directly.

If the molar's grid with cells of 2.4 mm were only smoothed by one sweep, the number of iterations
to a tolerance of 1e-6 would double.
"""
SPLIT_NODES = 4000
"""Largest number of nodes of a grid whose kernel launches run on one core.

Passing work to another thread takes about 50 us. Several cores therefore save time only for
launches of more than 0.2 ms.
"""
NULL_CUT = 1e-13
"""Threshold for eigenvalues of the coarsest grid's scaled stiffness, relative to the largest.

Eigenvalues below the threshold belong to motions that move no node of the finer grids.
"""


class GridLevel:
    """Grid with twice the cell edge of the next finer grid, and its Gauss-Seidel smoother.

    The stiffness is assembled in rows of 3 x 3 blocks. In a row, blocks of nodes with lower colours
    come first, see `HexGrid.node_colour`.

    Parameters
    ----------
    fine
        Next finer level.

    Attributes
    ----------
    load, vector, residual
        Warp arrays of vec3f, shape (n,): load [N], computed displacement [m] and residual [N].
    restrict, interpolate
        Launches that write the residual of the finer level to `load`, and that add `vector` to the
        displacement of the finer level.
    """

    def __init__(self, fine: "FinestLevel | GridLevel") -> None:
        grid, parent = fine.grid.coarse()
        device = fine.device
        count = grid.node_count
        self.grid: HexGrid = grid
        self.device: str = device
        self.cores: int | None = fine.cores
        self._parent = parent
        self.cell_nodes = put(grid.cell_nodes, wp.int32, device)
        self.live = wp.zeros(grid.cell_count, wp.uint8, device)
        self.stiffness = wp.zeros((grid.cell_count, BLOCKS), wp.mat33d, device)
        self.free = put(np.ones((count, 3)), wp.vec3d, device)
        self.load = wp.zeros(count, wp.vec3f, device)
        self.vector = wp.zeros(count, wp.vec3f, device)
        self.residual = wp.zeros(count, wp.vec3f, device)
        self._connect(fine)

        neighbours = grid.node_neighbours
        there = neighbours >= 0
        starts = np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int32)
        # Colour 8, after the eight colours, sorts missing neighbours to the end.
        colour = np.where(there, grid.node_colour[neighbours], 8)
        order = np.argsort(colour, axis=1, kind="stable")
        place = np.empty_like(neighbours)
        np.put_along_axis(place, order, starts[:-1, None] + np.arange(27, dtype=np.int32), axis=1)
        place[~there] = -1
        column = np.empty(int(starts[-1]), np.int32)
        column[place[there]] = neighbours[there]
        self._row_start = put(starts, wp.int32, device)
        self._column = put(column, wp.int32, device)
        self._block = wp.zeros(len(column), wp.mat33d, device)
        # Smoothing uses the blocks in single precision and the inverses of the diagonal blocks.
        single = wp.zeros(len(column), wp.mat33f, device)
        inverse = wp.zeros(count, wp.mat33f, device)
        self._assembled = [self._block, single, inverse]
        self._gathered = [
            self._row_start,
            put(grid.node_cells, wp.int32, device),
            put(place, wp.int32, device),
            self.free,
            self.cell_nodes,
            self.live,
            self.stiffness,
        ]
        launch = partial(SplitLaunch, cores=self.cores if count > SPLIT_NODES else 1)
        self._sweeps = []
        for each in range(8):
            nodes = np.flatnonzero(grid.node_colour == each)
            if len(nodes):
                rows = [nodes, self._row_start, self._column, single, inverse, self.load]
                self._sweeps.append(launch(sweep_colour, len(nodes), rows, [self.vector]))
        # Neighbour 13 of 27 is the node itself.
        rows = [self._row_start, place[:, 13], self._column, single, self.vector]
        self._leave_residual = launch(first_residuals, count, rows, [self.residual])

    def _connect(self, fine: "FinestLevel | GridLevel") -> None:
        """Record the transfer of stiffness, loads and displacements between the two levels."""
        grid = fine.grid
        place = grid.node_place
        children = np.full((self.grid.cell_count, 8), -1, dtype=np.int32)
        corner_of = (grid.cell_place & 1) @ (4, 2, 1)
        children[self._parent, corner_of] = np.arange(grid.cell_count, dtype=np.int32)
        self._projected = [
            fine.cell_nodes,
            fine.live,
            fine.stiffness,
            fine.free,
            put(children, wp.int32, fine.device),
        ]
        around = [grid.find_nodes(2 * self.grid.node_place + step) for step in NEIGHBOURS]
        odd = place & 1
        coarse_of = np.full((grid.node_count, 8), -1, dtype=np.int32)
        for corner, step in enumerate(CORNERS):
            wanted = (step <= odd).all(axis=1)
            coarse_of[wanted, corner] = self.grid.find_nodes((place[wanted] >> 1) + step)
        # The value at a node in the middle of a coarse edge, face or cell is the mean of 2, 4 or 8
        # coarse nodes.
        share = 0.5 ** odd.sum(axis=1)
        free = put(fine.free.numpy(), wp.vec3f, fine.device)
        launch = partial(SplitLaunch, cores=fine.cores)
        self.restrict = launch(
            restrict,
            self.grid.node_count,
            [np.stack(around, axis=1), free, fine.residual],
            [self.load],
        )
        self.interpolate = launch(
            interpolate, grid.node_count, [coarse_of, share, free, self.vector], [fine.vector]
        )

    def update(self, changed: Int32s) -> Int32s:
        """Update the stiffness after the stiffness of some cells of the finer level has changed.

        Return the indices of this level's cells that contain the changed cells.
        """
        cells = np.unique(self._parent[changed])
        inputs = [*self._projected, cells]
        run_once(coarse_stiffness, len(cells), inputs, [self.stiffness, self.live])
        nodes = np.unique(self.grid.cell_nodes[cells])
        run_once(assemble_rows, len(nodes), [nodes, *self._gathered], self._assembled)
        return cells

    def matrix(self) -> bsr_matrix:
        """Return the assembled matrix [N/m], shape (3 n, 3 n).

        On a CPU the matrix shares its values with this object.
        """
        arrays = (self._block.numpy(), self._column.numpy(), self._row_start.numpy())
        return bsr_matrix(arrays, shape=(3 * self.grid.node_count,) * 2, copy=False)

    def relax_first(self) -> None:
        """Run a Gauss-Seidel sweep that starts from zero, and compute the residual."""
        self.vector.zero_()
        for sweep in self._sweeps:
            sweep()
        self._leave_residual()

    def relax_last(self) -> None:
        """Run a Gauss-Seidel sweep in reverse order, from the corrected displacement."""
        for sweep in reversed(self._sweeps):
            sweep()


class GridHierarchy:
    """Preconditioner of a body's stiffness: one V-cycle over grids with doubling cell edges.

    Parameters
    ----------
    cells, supports
        Stiffness of the cells of the body, and supports of the nodes.

    Attributes
    ----------
    finest, coarser
        Grid of the body, and coarser grids. The cell edge doubles from grid to grid. The last grid
        is solved directly.
    """

    def __init__(self, cells: CellStiffness, supports: NodeSupports) -> None:
        self.finest = FinestLevel(cells, supports)
        self.coarser = [GridLevel(self.finest)]
        while self.coarser[-1].grid.node_count > COARSEST_NODES:
            self.coarser.append(GridLevel(self.coarser[-1]))
        self._coarsest_inverse = np.zeros((0, 0))
        self._stale = True

    def update(self, changed: Int32s) -> None:
        """Update all grids after the stiffness of some cells of the finest grid has changed.

        Call `refresh` to update the factorisation of the coarsest grid.
        """
        self.finest.update(changed)
        for level in self.coarser:
            changed = level.update(changed)
        self._stale = True

    def refresh(self) -> None:
        """Update the factorisation of the coarsest grid and the estimate of the largest eigenvalue.

        Do nothing if the body has not changed since the last call.
        """
        if not self._stale:
            return
        self.finest.bound_eigenvalues()
        matrix = self.coarser[-1].matrix().toarray()
        # Rounding makes the matrix unsymmetric, and `eigh` reads only one triangle.
        matrix = 0.5 * (matrix + matrix.T)
        size = np.diag(matrix)
        scale = np.where(size > 0.0, 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0)), 0.0)
        values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
        kept = values > NULL_CUT * values[-1]
        scaled = scale[:, None] * vectors[:, kept]
        self._coarsest_inverse = (scaled / values[kept]) @ scaled.T
        self._stale = False

    def __call__(self, residual: Array) -> Array:
        """Return a correction [m] for a residual [N], each of shape (n, 3).

        The map from residual to correction is linear, positive, and symmetric apart from rounding.
        """
        return self.finest.solve(residual, self._correct)

    def _correct(self) -> None:
        """Add the correction by the coarser grids to the vector of the finest grid."""
        *smoothed, last = self.coarser
        for level in smoothed:
            level.restrict()
            level.relax_first()
        last.restrict()
        solved = self._coarsest_inverse @ last.load.numpy().astype(np.float64).ravel()
        last.vector.assign(solved.reshape(-1, 3).astype(np.float32))
        last.interpolate()
        for level in reversed(smoothed):
            level.relax_last()
            level.interpolate()
