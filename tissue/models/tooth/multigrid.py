"""Multigrid preconditioner whose grids double the cell edge, with exact Galerkin projection.

After a change of a few cells, only the few coarse cells that contain these cells are computed
again. All grids therefore always represent the present body. One symmetric V-cycle in single
precision is the preconditioner of conjugate gradients. On the finest grid, which has no assembled
rows, the smoother is Chebyshev's polynomial. On the coarser grids the smoother is Gauss-Seidel over
eight colours of nodes. After the correction by the next coarser grid, the colours are visited in
reverse order. (Trottenberg, Oosterlee, Schueller 2001, Multigrid, ch. 2.)
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from kernels.grid_transfer import (
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
from tissue.models.tooth.finest_level import FinestLevel, NodeBlocks
from tissue.models.tooth.grid import CORNERS, NEIGHBOURS, HexGrid, NodeSupports
from tissue.models.tooth.stiffness import CellStiffness


class GridTransfer:
    """Recorded kernel launches for the transfer between a fine and a coarse grid.

    Parameters
    ----------
    fine, coarse
        Fine and coarse grid level.
    parent
        Coarse cell of each fine cell, int32, shape (c,).

    Attributes
    ----------
    down
        Kernel launch that restricts the fine residual to the coarse load.
    up
        Kernel launch that adds the coarse displacement to the fine displacement.
    """

    def __init__(
        self, fine: "FinestLevel | GridLevel", coarse: "GridLevel", parent: Int32s
    ) -> None:
        grid = fine.grid
        coarse_grid = coarse.grid

        launch = partial(SplitLaunch, cores=fine.cores)
        children = np.full((coarse_grid.cell_count, 8), -1, dtype=np.int32)
        children[parent, (grid.cell_place & 1) @ (4, 2, 1)] = np.arange(
            grid.cell_count, dtype=np.int32
        )
        self._parent = parent
        self._inputs = [
            fine.cell_nodes,
            fine.live,
            fine.stiffness,
            fine.free,
            put(children, wp.int32, fine.device),
        ]
        self._outputs = [coarse.stiffness, coarse.live]
        place = grid.node_place
        fine_of = np.stack(
            [grid.find_nodes(2 * coarse_grid.node_place + step) for step in NEIGHBOURS], axis=1
        )
        odd = place & 1
        coarse_of = np.full((grid.node_count, 8), -1, dtype=np.int32)
        for corner, step in enumerate(CORNERS):
            wanted = (step <= odd).all(axis=1)
            coarse_of[wanted, corner] = coarse_grid.find_nodes((place[wanted] >> 1) + step)
        free = put(fine.free.numpy(), wp.vec3f, fine.device)
        inputs = [fine_of, free, fine.residual]
        self.down = launch(restrict, coarse_grid.node_count, inputs, [coarse.load])
        inputs = [
            coarse_of,
            # The value at a node in the middle of a coarse edge, face or cell is the mean of 2, 4
            # or 8 coarse nodes.
            0.5 ** odd.sum(axis=1),
            free,
            coarse.vector,
        ]
        self.up = launch(interpolate, grid.node_count, inputs, [fine.vector])

    def project(self, changed: Int32s) -> Int32s:
        """Update the stiffness of the coarse cells that contain changed cells.

        Return the indices of these coarse cells.
        """
        cells = np.unique(self._parent[changed])
        run_once(coarse_stiffness, len(cells), [*self._inputs, cells], self._outputs)
        return cells


COARSEST_NODES = 300
"""Largest number of nodes of a grid that is solved directly.

If the molar's grid with cells of 2.4 mm were smoothed by one sweep instead of solved directly, the
number of iterations to a tolerance of 1e-6 would double.
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
    """One coarser grid, with its stiffness, vectors and Gauss-Seidel smoother.

    Attributes
    ----------
    load, vector, residual
        Warp arrays of vec3f, shape (n,): load [N], computed displacement [m] and residual [N].
    """

    def __init__(self, grid: HexGrid, *, device: str, cores: int | None) -> None:
        self.grid = grid
        self.device = device
        self.cores = cores
        self.cell_nodes = put(grid.cell_nodes, wp.int32, device)
        self.live = wp.zeros(grid.cell_count, wp.uint8, device)
        self.stiffness = wp.zeros((grid.cell_count, BLOCKS), wp.mat33d, device)
        self.blocks = NodeBlocks(
            grid,
            cell_nodes=self.cell_nodes,
            live=self.live,
            stiffness=self.stiffness,
            device=device,
        )
        self.free = self.blocks.free
        self.load = wp.zeros(grid.node_count, wp.vec3f, device)
        self.vector = wp.zeros(grid.node_count, wp.vec3f, device)
        self.residual = wp.zeros(grid.node_count, wp.vec3f, device)
        split = cores if grid.node_count > SPLIT_NODES else 1
        launch = partial(SplitLaunch, cores=split)
        self._sweeps = self._recorded(launch)
        blocks = self.blocks
        rows = [blocks.row_start, blocks.diagonal_block, blocks.column, blocks.single]
        self._leave_residual = launch(
            first_residuals, grid.node_count, [*rows, self.vector], [self.residual]
        )

    def _recorded(self, launch: Callable[..., SplitLaunch]) -> list[SplitLaunch]:
        """Return the launches of a Gauss-Seidel sweep, one for each colour."""
        blocks = self.blocks
        sweeps = []
        for colour in range(8):
            nodes = np.flatnonzero(self.grid.node_colour == colour)
            count = len(nodes)
            if count == 0:
                continue
            rows = [nodes, blocks.row_start, blocks.column, blocks.single, blocks.inverse]
            sweeps.append(launch(sweep_colour, count, [*rows, self.load], [self.vector]))
        return sweeps

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
    """Preconditioner of a body's stiffness: one V-cycle over grids whose edge doubles.

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
        self.coarser: list[GridLevel] = []
        self._transfers: list[GridTransfer] = []
        level: FinestLevel | GridLevel = self.finest
        while level is self.finest or level.grid.node_count > COARSEST_NODES:
            grid, parent = level.grid.coarse()
            coarse = GridLevel(grid, device=cells.device, cores=cells.cores)
            self._transfers.append(GridTransfer(level, coarse, parent))
            self.coarser.append(coarse)
            level = coarse
        self._coarsest_inverse = np.zeros((0, 0))
        self._stale = True

    def update(self, changed: Int32s) -> None:
        """Update all grids after a change of some cells of the finest grid.

        Call `refresh` to update the factorisation of the coarsest grid.
        """
        self.finest.update(np.unique(self.finest.grid.cell_nodes[changed]))
        for level, transfer in zip(self.coarser, self._transfers, strict=True):
            changed = transfer.project(changed)
            level.blocks.update(np.unique(level.grid.cell_nodes[changed]))
        self._stale = True

    def refresh(self) -> None:
        """Update the factorisation of the coarsest grid and the estimate of the largest eigenvalue.

        If nothing has changed since the last call, do nothing.
        """
        if not self._stale:
            return
        self.finest.bound_eigenvalues()
        matrix = self.coarser[-1].blocks.matrix().toarray()
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
        self._transfers[0].down()
        for level, transfer in zip(self.coarser, self._transfers[1:], strict=False):
            level.relax_first()
            transfer.down()
        last = self.coarser[-1]
        solved = self._coarsest_inverse @ last.load.numpy().astype(np.float64).ravel()
        last.vector.assign(solved.reshape(-1, 3).astype(np.float32))
        for level, transfer in zip(self.coarser[-2::-1], self._transfers[:0:-1], strict=True):
            transfer.up()
            level.relax_last()
        self._transfers[0].up()
