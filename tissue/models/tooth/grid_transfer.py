"""From a grid to the one of twice its edge and back: stiffness and residuals up, corrections down."""

from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.grid_transfer import coarse_stiffness, interpolate, restrict
from kernels.launcher import SplitLaunch
from tissue.models.tooth.grid import CORNERS, NEIGHBOURS, HexGrid

__all__ = ["GridTransfer", "TransferLevel"]


class TransferLevel(Protocol):
    """What a transfer needs of a grid: its cells and nodes as Warp arrays.

    Attributes
    ----------
    cell_nodes, live, stiffness
        Of the cells, as in :class:`tissue.models.tooth.stiffness.CellStiffness`.
    free
        1 where a component may move, vec3d, shape (n,).
    vector, residual
        Displacement [m] and residual [N], vec3f, shape (n,).
    """

    grid: HexGrid
    device: str
    cores: int | None
    cell_nodes: Any
    live: Any
    stiffness: Any
    free: Any
    vector: Any
    residual: Any


class GridTransfer:
    """Recorded launches between two levels.

    Parameters
    ----------
    fine, coarse
        The levels; the coarse one has a ``load`` besides.
    parent
        Coarse cell of each fine cell, int32, shape (c,).

    Attributes
    ----------
    down
        Takes the fine residual to the coarse load.
    up
        Adds the coarse displacement to the fine one.
    """

    def __init__(self, fine: TransferLevel, coarse: Any, parent: NDArray[np.int32]) -> None:
        device, grid, coarse_grid = fine.device, fine.grid, coarse.grid

        def on(array: NDArray[Any], dtype: Any) -> Any:
            return wp.array(np.ascontiguousarray(array), dtype=dtype, device=device)

        def launch(kernel: Any, dim: int, inputs: list[Any], outputs: list[Any]) -> SplitLaunch:
            return SplitLaunch(
                kernel, dim=dim, inputs=[*inputs, 0], outputs=outputs, offset_index=len(inputs), device=device,
                cores=fine.cores,
            )  # fmt: skip

        children = np.full((coarse_grid.cell_count, 8), -1, dtype=np.int32)
        children[parent, (grid.cell_place & 1) @ (4, 2, 1)] = np.arange(grid.cell_count, dtype=np.int32)
        self._parent, self._device = parent, device
        self._inputs = [fine.cell_nodes, fine.live, fine.stiffness, fine.free, on(children, wp.int32)]
        self._outputs = [coarse.stiffness, coarse.live]
        place = grid.node_place
        fine_of = np.stack([grid.find_nodes(2 * coarse_grid.node_place + step) for step in NEIGHBOURS], axis=1)
        odd = place & 1
        coarse_of = np.full((grid.node_count, 8), -1, dtype=np.int32)
        for corner, step in enumerate(CORNERS):
            wanted = (step <= odd).all(axis=1)
            coarse_of[wanted, corner] = coarse_grid.find_nodes((place[wanted] >> 1) + step)
        free = on(fine.free.numpy(), wp.vec3f)
        inputs = [on(fine_of, wp.int32), free, fine.residual]
        self.down = launch(restrict, coarse_grid.node_count, inputs, [coarse.load])
        inputs = [on(coarse_of, wp.int32), on(0.5 ** odd.sum(axis=1), wp.float32), free, coarse.vector]
        self.up = launch(interpolate, grid.node_count, inputs, [fine.vector])

    def project(self, changed: NDArray[np.int32]) -> NDArray[np.int32]:
        """Sum the coarse cells over these changed cells again; which they are."""
        cells = np.unique(self._parent[changed])
        arrays = [*self._inputs, wp.array(cells, dtype=wp.int32, device=self._device), 0]
        wp.launch(coarse_stiffness, dim=len(cells), inputs=arrays, outputs=self._outputs, device=self._device)
        return cells
