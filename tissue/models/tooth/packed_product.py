"""Product of the packed stiffness of some cells of a grid with a vector."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.hexahedra import cell_products, gather_cells
from kernels.launcher import SplitLaunch
from tissue.models.tooth.grid import HexGrid

__all__ = ["PackedProduct"]


class PackedProduct:
    """Recorded product of some cells with nodal displacements, added to nodal forces.

    Parameters
    ----------
    grid
        The grid.
    cells, rows
        Cells of the product, shape (k,), and their rows in ``stiffness``.
    stiffness
        Warp array of packed stiffness [N/m], as in :mod:`kernels.hexahedra`; read at every call.
    live
        Warp array, 0 where a cell carries nothing, shape (c,).
    vector, force
        Warp arrays of vec3d: displacement of the nodes [m], and what the product is added to [N], shape (n,).
    cores
        Processor cores to split launches over.
    """

    def __init__(
        self, grid: HexGrid, cells: NDArray[np.integer], rows: NDArray[np.integer], stiffness: Any, *, live: Any,
        vector: Any, force: Any, cores: int | None,
    ) -> None:  # fmt: skip
        device = str(vector.device)

        def on(array: NDArray[Any]) -> Any:
            return wp.array(array.astype(np.int32), dtype=wp.int32, device=device)

        place = np.full(grid.cell_count + 1, -1)
        place[cells] = np.arange(len(cells))
        nodes = np.unique(grid.cell_nodes[cells])
        corner_force = wp.zeros((len(cells), 8), dtype=wp.vec3d, device=device)
        self._cells = SplitLaunch(
            cell_products, dim=len(cells), offset_index=6, device=device, cores=cores,
            inputs=[on(cells), on(rows), on(grid.cell_nodes), live, stiffness, vector, 0], outputs=[corner_force],
        )  # fmt: skip
        self._nodes = SplitLaunch(
            gather_cells, dim=len(nodes), offset_index=3, device=device, cores=cores,
            inputs=[on(nodes), on(place[grid.node_cells[nodes]]), corner_force, 0], outputs=[force],
        )  # fmt: skip

    def __call__(self) -> None:
        """Add the product."""
        self._cells()
        self._nodes()
