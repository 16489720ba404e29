"""Multigrid smoothing on the finest grid.

On the finest grid the stiffness is not assembled: products with the stiffness are computed over
strips of eight cells.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from kernels.lane_vectors import from_lanes, node_diagonals, smooth, to_lanes
from kernels.launcher import SplitLaunch, run_once
from kernels.mirror import put
from meshes.base.arrays import Array, Int32s
from tissue.models.tooth.grid import NodeSupports
from tissue.models.tooth.stiffness import CellStiffness
from tissue.models.tooth.strips import LaneVector, StripProduct

STEPS = ((0.0, 4.0 / 3.0), (1.0 / 5.0, 12.0 / 5.0))
"""Factors of the previous direction and of the residual in each smoothing step.

The steps form a Chebyshev polynomial of the fourth kind with degree 2. This polynomial needs only
the largest eigenvalue (Lottes 2023, Numer. Linear Algebra Appl. 30:e2518). With degree 1, 1.3 times
as many iterations are needed. Degree 3 saves no iteration.
"""
POWER_STEPS = 30
"""Number of steps of the power method.

For the molar, the eigenvalue after this number of steps is 3 % below the eigenvalue after 100
steps.
"""
MARGIN = 1.15
"""Factor by which the computed largest eigenvalue is multiplied.

The computed eigenvalue is too small because of the error of the power method. In addition, cuts
increase the true eigenvalue until it is computed again. The smoother diverges if the true
eigenvalue is 1.25 times the assumed value.
"""


class FinestLevel:
    """Multigrid smoothing on the finest grid, in single precision and with SIMD instructions.

    For cells that are grouped in strips of eight, the smoother ignores the ligament springs. The
    stiffness of these springs is below a hundredth of the stiffness of their cells, and the coarser
    grids include the springs. In the scenes with a molar and with caries, a smoother with the
    springs would need equally many iterations. With a ligament 100 times as stiff, it would save
    one of ten iterations. The position of every particle is used without approximation. If
    particles were moved to the centres of eight equal cubes of their cell, a molar on a rotated
    grid would need 31 to 44 iterations instead of 14 to 15.

    Parameters
    ----------
    cells, supports
        Stiffness of the cells of a body, and supports of the nodes.

    Attributes
    ----------
    diagonal
        Diagonal of the stiffness [N/m], Warp array of vec3d, shape (n,). It is 1 at held
        components.
    vector, residual
        Correction by the coarser grids [m], and residual load after smoothing [N], Warp arrays of
        vec3f, shape (n,).
    """

    def __init__(self, cells: CellStiffness, supports: NodeSupports) -> None:
        self.grid = cells.grid
        self.device = cells.device
        self.cores = cells.cores
        self._cells = cells
        self.cell_nodes = cells.cell_nodes_on
        self.live = cells.live_on
        self.stiffness = cells.stiffness
        count = self.grid.node_count
        device = cells.device
        self.free = put((~supports.fixed).astype(np.float64), wp.vec3d, device)
        self.diagonal = wp.zeros(count, wp.vec3d, device)
        self.vector = wp.zeros(count, wp.vec3f, device)
        self.residual = wp.zeros(count, wp.vec3f, device)
        # Any positive value is allowed here: the first refresh replaces it.
        self._largest = 4.0
        lanes = [LaneVector(cells.layout, wp.float32, device=device) for _ in range(5)]
        self._inverse, self._force, self._left, self._direction, self._found = lanes
        inverse, *vectors = [each.by_eight for each in lanes]
        self._product = StripProduct(
            cells.layout,
            cells.single,
            self._direction,
            self._force,
            device=device,
            cores=cells.cores,
        )

        launch = partial(SplitLaunch, cores=cells.cores)
        self._steps = [
            launch(smooth, vectors[0].shape[1], [inverse, *step], vectors)
            # The last step adds the last direction and starts no new one.
            for step in (*STEPS, (0.0, 0.0))
        ]
        slot = cells.slot_on
        self._take_load = launch(to_lanes, count, [slot, self.residual], [self._left.single])
        self._give_residual = launch(from_lanes, count, [slot, self._left.single], [self.residual])
        self._take_correction = launch(
            to_lanes, count, [slot, self.vector], [self._direction.single]
        )
        self._give_direction = launch(
            from_lanes, count, [slot, self._direction.single], [cells.displacement]
        )
        self._take_force = launch(to_lanes, count, [slot, cells.force], [self._force.single])
        self._give_found = launch(from_lanes, count, [slot, self._found.single], [self.vector])

    def update(self, changed: Int32s) -> None:
        """Update the diagonal of the stiffness at the nodes of changed cells."""
        nodes = np.unique(self.grid.cell_nodes[changed])
        inputs = [
            nodes,
            self._cells.node_cells_on,
            self.live,
            self.stiffness,
            self.free,
            self._cells.slot_on,
            self._largest,
        ]
        outputs = [self.diagonal, self._inverse.single]
        run_once(node_diagonals, len(nodes), inputs, outputs)

    def bound_eigenvalues(self) -> None:
        """Estimate the largest eigenvalue of D^-1 K as `MARGIN` times the power method's result.

        D is the diagonal of the stiffness K. The stored inverse of D is divided by this estimate.
        """
        layout = self._cells.layout
        inverse = self._inverse.single.numpy()
        vector = np.zeros((3, layout.slots), np.float32)
        vector[:, layout.slot] = np.random.default_rng(0).normal(size=(3, self.grid.node_count))
        size = 1.0
        for _ in range(POWER_STEPS):
            self._direction.single.assign(vector)
            self._force.single.zero_()
            self._multiply()
            vector = self._inverse.single.numpy() * self._force.single.numpy()
            size = float(np.linalg.norm(vector))
            # No cell carries load.
            if size == 0.0:
                break
            vector /= size
        if size > 0.0:
            self._largest *= MARGIN * size
            self._inverse.single.assign(inverse / (MARGIN * size))
        for each in (self._force, self._direction, self._found):
            each.single.zero_()

    def solve(self, load_N: Array, correct: Callable[[], None]) -> Array:
        """Run one multigrid cycle for a load [N], and return the displacement [m].

        Load and displacement have shape (n, 3). The cycle smooths, calls ``correct`` and smooths
        again.

        ``correct`` is a function that reads ``residual`` and adds the correction by the coarser
        grids to ``vector``.
        """
        self._found.single.zero_()
        self._direction.single.zero_()
        self._force.single.zero_()
        self.residual.assign(load_N.astype(np.float32))
        self._take_load()
        self._smooth()
        self._multiply()
        self._steps[2]()
        self._give_residual()
        self.vector.zero_()
        correct()
        self._take_correction()
        self._multiply()
        self._smooth()
        self._steps[2]()
        self._give_found()
        return self.vector.numpy().astype(np.float64)

    def _smooth(self) -> None:
        self._steps[0]()
        self._multiply()
        self._steps[1]()

    def _multiply(self) -> None:
        """Add the product of the stiffness and the present search direction to the force.

        If some cells are not in strips (groups of eight cells), the force must be zero before the
        call.
        """
        if self._cells.others:
            self._give_direction()
            self._cells.force.zero_()
            for launch in self._cells.others:
                launch()
            self._take_force()
        self._product()
