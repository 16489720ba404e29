"""Multigrid on the cells' own grid: every coarser grid has twice the edge, and the exact Galerkin projection.

A change of a few cells is carried up through the few coarse cells over them, so that the hierarchy is always that of
the present body. One symmetric V-cycle, Gauss-Seidel over eight colours before and in reverse after, in single
precision, is the preconditioner of conjugate gradients. (Trottenberg, Oosterlee, Schueller 2001, Multigrid, ch. 2.)
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.grid_transfer import coarse_stiffness, interpolate, restrict
from kernels.launcher import SplitLaunch
from kernels.node_blocks import first_residuals, first_sweep, sweep_colour
from tissue.models.tooth.blocks import NodeBlocks
from tissue.models.tooth.grid import CORNERS, NEIGHBOURS, HexGrid
from tissue.models.tooth.stiffness import CellStiffness
from tissue.models.tooth.supports import NodeSupports

__all__ = ["GridHierarchy"]

Array = NDArray[np.float64]
COARSEST_NODES = 100
"""Grids of at most this many nodes are solved directly."""
NULL_CUT = 1e-13
"""Scaled eigenvalues of the coarsest grid below this share of the largest are motions that no finer node takes."""


class GridLevel:
    """One grid: its rows, its vectors, and the launches of a V-cycle on it."""

    def __init__(
        self, grid: HexGrid, supports: NodeSupports, *, cell_nodes: Any, node_cells: Any, live: Any, stiffness: Any,
        device: str, cores: int | None,
    ) -> None:  # fmt: skip
        self.grid, self.supports, self.device, self.cores = grid, supports, device, cores
        self.cell_nodes, self.live, self.stiffness = cell_nodes, live, stiffness
        self.blocks = NodeBlocks(
            grid, supports, cell_nodes=cell_nodes, node_cells=node_cells, live=live, stiffness=stiffness, device=device
        )
        self.load = wp.zeros(grid.node_count, dtype=wp.vec3f, device=device)
        self.vector = wp.zeros(grid.node_count, dtype=wp.vec3f, device=device)
        self.residual = wp.zeros(grid.node_count, dtype=wp.vec3f, device=device)
        self.first_sweeps, self.last_sweeps = self._sweeps()
        blocks = self.blocks
        rows = [blocks.row_start, blocks.diagonal_block, blocks.column, blocks.single]
        self.leave_residual = self._launch(first_residuals, [*rows, self.vector], [self.residual])

    def _launch(self, kernel: Any, inputs: list[Any], outputs: list[Any], dim: int | None = None) -> SplitLaunch:
        cores = self.cores if self.grid.node_count > 4000 else 1
        return SplitLaunch(
            kernel, dim=self.grid.node_count if dim is None else dim, inputs=[*inputs, 0], outputs=outputs,
            offset_index=len(inputs), device=self.device, cores=cores,
        )  # fmt: skip

    def _sweeps(self) -> tuple[list[SplitLaunch], list[SplitLaunch]]:
        """Gauss-Seidel from rest, colour after colour, and any other in reverse."""
        blocks = self.blocks
        first, last = [], []
        for colour in range(8):
            nodes = np.flatnonzero(self.grid.node_colour == colour).astype(np.int32)
            if len(nodes) == 0:
                continue
            on: Any = wp.array(nodes, dtype=wp.int32, device=self.device)
            rows = [blocks.column, blocks.single, blocks.inverse, self.load]
            first.append(
                self._launch(
                    first_sweep, [on, blocks.row_start, blocks.diagonal_block, *rows], [self.vector], len(nodes)
                )
            )
            last.append(self._launch(sweep_colour, [on, blocks.row_start, *rows], [self.vector], len(nodes)))
        return first, last[::-1]

    def connect(self, coarse_grid: HexGrid, parent: NDArray[np.int32]) -> "GridLevel":
        """The next coarser level, and the launches between the two."""
        fine, device = self.grid, self.device

        def on(array: NDArray[Any], dtype: Any) -> Any:
            return wp.array(np.ascontiguousarray(array), dtype=dtype, device=device)

        children = np.full((coarse_grid.cell_count, 8), -1, dtype=np.int32)
        children[parent, (fine.cell_place & 1) @ (4, 2, 1)] = np.arange(fine.cell_count, dtype=np.int32)
        live = wp.zeros(coarse_grid.cell_count, dtype=wp.uint8, device=device)
        stiffness = wp.zeros((coarse_grid.cell_count, 36), dtype=wp.mat33d, device=device)
        coarse = GridLevel(
            coarse_grid, NodeSupports.of(coarse_grid.node_count), cell_nodes=on(coarse_grid.cell_nodes, wp.int32),
            node_cells=on(coarse_grid.node_cells, wp.int32), live=live, stiffness=stiffness, device=device,
            cores=self.cores,
        )  # fmt: skip
        self.parent = parent
        self._project = (
            [self.cell_nodes, self.live, self.stiffness, self.blocks.free, on(children, wp.int32)],
            [stiffness, live],
        )
        free = on(~self.supports.fixed, wp.vec3f)
        place, coarse_place = fine.node_place, coarse_grid.node_place
        fine_of = np.stack([fine.find_nodes(2 * coarse_place + step) for step in NEIGHBOURS], axis=1)
        odd = place & 1
        coarse_of = np.full((fine.node_count, 8), -1, dtype=np.int32)
        for corner, step in enumerate(CORNERS):
            wanted = (step <= odd).all(axis=1)
            coarse_of[wanted, corner] = coarse_grid.find_nodes((place[wanted] >> 1) + step)
        self.down = coarse._launch(restrict, [on(fine_of, wp.int32), free, self.residual], [coarse.load])
        inputs = [on(coarse_of, wp.int32), on(0.5 ** odd.sum(axis=1), wp.float32), free, coarse.vector]
        self.up = self._launch(interpolate, inputs, [self.vector])
        return coarse

    def project(self, changed: NDArray[np.int32]) -> NDArray[np.int32]:
        """Sum the coarse cells over these changed cells again; which they are."""
        cells = np.unique(self.parent[changed])
        inputs, outputs = self._project
        arrays = [*inputs, wp.array(cells, dtype=wp.int32, device=self.device), 0]
        wp.launch(coarse_stiffness, dim=len(cells), inputs=arrays, outputs=outputs, device=self.device)
        return cells


class GridHierarchy:
    """Preconditioner of a body's stiffness: one V-cycle over grids of doubling edge.

    Parameters
    ----------
    cells, supports
        The body's stiffness on its grid, and what holds it.
    """

    def __init__(self, cells: CellStiffness, supports: NodeSupports) -> None:
        level = GridLevel(
            cells.grid, supports, cell_nodes=cells.cell_nodes_on, node_cells=cells.node_cells_on, live=cells.live_on,
            stiffness=cells.stiffness, device=cells.device, cores=cells.cores,
        )  # fmt: skip
        self.levels = [level]
        while level.grid.node_count > COARSEST_NODES and level.grid.cell_count > 1:
            level = level.connect(*level.grid.coarse())
            self.levels.append(level)
        self._coarsest_inverse = np.zeros((0, 0))
        self._stale = True

    def update(self, changed: NDArray[np.int32]) -> None:
        """Carry a change of these cells through all grids; the coarsest one waits for `refresh`."""
        for level in self.levels:
            level.blocks.update(np.unique(level.grid.cell_nodes[changed]))
            if level is not self.levels[-1]:
                changed = level.project(changed)
        self._stale = True

    def diagonal(self) -> Array:
        """Diagonal of the finest stiffness [N/m], shape (n, 3)."""
        return np.asarray(np.diagonal(self.levels[0].blocks.diagonal.numpy(), axis1=1, axis2=2))

    def refresh(self) -> None:
        """Solve the coarsest grid anew, if anything changed since."""
        if not self._stale:
            return
        blocks = self.levels[-1].blocks
        matrix = blocks.matrix().toarray()
        matrix = 0.5 * (matrix + matrix.T)
        size = np.diag(matrix)
        scale = np.where(size > 0.0, 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0)), 0.0)
        values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
        kept = values > NULL_CUT * values[-1]
        scaled = scale[:, None] * vectors[:, kept]
        self._coarsest_inverse = (scaled / values[kept]) @ scaled.T
        self._stale = False

    def __call__(self, residual: Array) -> Array:
        """Correction [m] for a residual [N], shapes (n, 3): linear, symmetric up to rounding, positive."""
        first = self.levels[0]
        first.load.assign(residual.astype(np.float32))
        for level in self.levels[:-1]:
            for sweep in level.first_sweeps:
                sweep()
            level.leave_residual()
            level.down()
        last = self.levels[-1]
        solved = self._coarsest_inverse @ last.load.numpy().astype(np.float64).ravel()
        last.vector.assign(solved.reshape(-1, 3).astype(np.float32))
        for level in reversed(self.levels[:-1]):
            level.up()
            for sweep in level.last_sweeps:
                sweep()
        return np.asarray(first.vector.numpy().astype(np.float64))
