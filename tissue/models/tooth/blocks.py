"""Stiffness of a grid assembled node by node, in a pattern that never changes."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix

from kernels.node_blocks import assemble_rows, invert_diagonal, to_single
from tissue.models.tooth.grid import HexGrid

__all__ = ["NodeBlocks"]


class NodeBlocks:
    """Rows of 3 x 3 blocks of K, no node of which is held.

    Parameters
    ----------
    grid
        The grid.
    cell_nodes, live, stiffness
        Warp arrays of the cells, as in :class:`tissue.models.tooth.stiffness.CellStiffness`; read at every `update`.
    device
        Warp device.

    Attributes
    ----------
    row_start, column, block
        Block compressed rows: int32 (n + 1,), int32 (b,), 3 x 3 float64 (b,) [N/m]; lower colours first.
    diagonal_block
        Place of each node's own block, int32 (n,).
    diagonal
        Own block of each node with 1 on held components, float64 (n,).
    single, inverse
        Blocks and inverses of the diagonal in single precision, for smoothing.
    """

    def __init__(self, grid: HexGrid, *, cell_nodes: Any, live: Any, stiffness: Any, device: str) -> None:
        neighbours = grid.node_neighbours
        there = neighbours >= 0
        starts = np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int32)
        colour = np.where(there, grid.node_colour[neighbours], 8)
        order = np.argsort(colour, axis=1, kind="stable")
        place = np.empty_like(neighbours)
        np.put_along_axis(place, order, starts[:-1, None] + np.arange(27, dtype=np.int32), axis=1)
        place[~there] = -1
        column = np.empty(int(starts[-1]), dtype=np.int32)
        column[place[there]] = neighbours[there]

        def on(array: NDArray[Any], dtype: Any) -> Any:
            return wp.array(np.ascontiguousarray(array), dtype=dtype, device=device)

        self.device = device
        self.row_start, self.column = on(starts, wp.int32), on(column, wp.int32)
        self.diagonal_block = on(place[:, 13], wp.int32)
        self.free = on(np.ones((grid.node_count, 3)), wp.vec3d)
        self.block = wp.zeros(int(starts[-1]), dtype=wp.mat33d, device=device)
        self.single = wp.zeros(int(starts[-1]), dtype=wp.mat33f, device=device)
        self.diagonal = wp.zeros(grid.node_count, dtype=wp.mat33d, device=device)
        self.inverse = wp.zeros(grid.node_count, dtype=wp.mat33f, device=device)
        self._gathered = [
            self.row_start,
            on(grid.node_cells, wp.int32),
            on(place, wp.int32),
            self.free,
            cell_nodes,
            live,
            stiffness,
        ]

    def update(self, nodes: NDArray[np.int32]) -> None:
        """Gather the rows of these nodes again from their cells."""
        if len(nodes) == 0:
            return
        rows: Any = wp.array(nodes, dtype=wp.int32, device=self.device)

        def launch(kernel: Any, inputs: list[Any], outputs: list[Any]) -> None:
            wp.launch(kernel, dim=len(nodes), inputs=[rows, *inputs, 0], outputs=outputs, device=self.device)

        launch(assemble_rows, self._gathered, [self.block, self.diagonal])
        launch(to_single, [self.row_start, self.block], [self.single])
        launch(invert_diagonal, [self.diagonal], [self.inverse])

    def matrix(self) -> bsr_matrix:
        """The assembled matrix [N/m], shape (3 n, 3 n), on a CPU sharing its values with this object."""
        count = len(self.diagonal)
        arrays = (self.block.numpy(), self.column.numpy(), self.row_start.numpy())
        return bsr_matrix(arrays, shape=(3 * count, 3 * count), copy=False)
