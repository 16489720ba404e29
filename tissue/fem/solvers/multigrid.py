"""Conjugate gradients preconditioned by smoothed aggregation with the six rigid motions.

For large meshes: memory and time of one right side grow linearly. The matrix is scaled by its diagonal, so that cells
of any size count alike, and kept in blocks of 3x3, so that nodes are aggregated and not components (Vanek, Mandel,
Brezina 1996, Computing 56:179).
"""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal
from scipy.sparse import bsr_matrix

from meshes.base.errors import InputError, require_range
from tissue.fem.free_modes import rigid_modes
from tissue.fem.outcome import SolverOutcome
from tissue.fem.solvers.solution import HeldBody, Solution

__all__ = ["MultigridSolver"]

Array = NDArray[np.float64]
COARSEST_NODES = 50
"""Levels of at most so many aggregates are solved directly."""
WEAK = 0.05
"""Couplings below this share of their nodes' own do not join an aggregate: a third fewer iterations than with all."""
LEAST_SHARE = 1e-13
"""Residuals below this share of the load are rounding."""


class MultigridSolver:
    """Iterates; set up once, warm starts welcome.

    Parameters
    ----------
    body
        The stiffness and what holds it.
    tolerance
        Relative error in the energy norm. It is estimated as ``sqrt(r . B r / l)``, r the residual, B a cycle, and l
        the smallest eigenvalue of B K that the iterations have met (Meurant and Strakos 2006, Acta Numer. 15:471).
    limit
        Iterations allowed.

    Raises
    ------
    InputError
        If the tolerance is not in [1e-12, 0.1], or the stiffness has a component that is not positive.
    """

    def __init__(self, body: HeldBody, *, tolerance: float = 1e-8, limit: int = 500) -> None:
        from pyamg import smoothed_aggregation_solver

        self.tolerance = require_range("tolerance", tolerance, 1e-12, 0.1, "use 1e-8")
        self.body, self._limit = body, limit
        self._free = np.zeros(3 * len(body.nodes_m), dtype=np.bool_)
        self._free[body.free] = True
        diagonal = body.sprung.diagonal()
        if not (diagonal[self._free] > 0.0).all():
            raise InputError("stiffness must be positive definite, got a diagonal that is not: check the moduli")
        self._scale = np.where(self._free, 1.0 / np.sqrt(np.where(self._free, diagonal, 1.0)), 0.0)
        self._matrix = self._scaled()
        modes = rigid_modes(body.nodes_m, body.nodes_m.mean(axis=0)).reshape(-1, 6)
        size = np.abs(modes).max(axis=0)
        near_null = np.divide(modes / size, self._scale[:, None], out=np.zeros_like(modes), where=self._free[:, None])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # small coarse grids bring remarks on their rank
            self._hierarchy = smoothed_aggregation_solver(
                self._matrix, B=near_null, strength=("symmetric", {"theta": WEAK}), max_coarse=COARSEST_NODES,
                improve_candidates=None,
            )  # fmt: skip
        self._cycle = self._hierarchy.aspreconditioner(cycle="V")
        self._least = 1.0

    def _scaled(self) -> Any:
        """D^-1/2 K D^-1/2 with held components cut out to the identity, indices of 32 bits as pyamg wants."""
        rows = self.body.sprung.tobsr((3, 3))
        count = len(self.body.nodes_m)
        scale = self._scale.reshape(-1, 3)
        row = np.repeat(np.arange(count), np.diff(rows.indptr))
        data = rows.data * scale[row][:, :, None] * scale[rows.indices][:, None, :]
        diagonal = np.flatnonzero(row == rows.indices)
        node, axis = np.nonzero(~self._free.reshape(-1, 3))
        place = np.full(count, -1)
        place[row[diagonal]] = diagonal
        with_block = place[node] >= 0
        data[place[node[with_block]], axis[with_block], axis[with_block]] = 1.0
        indices, starts = rows.indices.astype(np.int32), rows.indptr.astype(np.int32)
        return bsr_matrix((data, indices, starts), shape=rows.shape)

    @property
    def memory_bytes(self) -> int:
        """Memory of the matrices of all levels."""
        matrices = [part for level in self._hierarchy.levels for part in (level.A, getattr(level, "P", None),
                    getattr(level, "R", None)) if part is not None]  # fmt: skip
        return sum(m.data.nbytes + m.indices.nbytes + m.indptr.nbytes for m in matrices)

    def solve(self, load_N: Array, *, start_m: Array | None = None) -> Solution:
        """Displacement under nodal forces [N], shape (n, 3), from a guess [m], shape (n, 3).

        Raises
        ------
        InputError
            If the load or the guess has another shape or is not finite.
        """
        body = self.body
        right = np.zeros(len(self._scale))
        right[body.free] = body.right_side(load_N)
        right *= self._scale
        found = np.zeros_like(right)
        if start_m is not None:
            if np.shape(start_m) != body.nodes_m.shape or not np.isfinite(start_m).all():
                raise InputError(f"start_m must be finite and of shape {body.nodes_m.shape}: leave it out")
            found[self._free] = np.asarray(start_m).ravel()[self._free] / self._scale[self._free]
        found, outcome, iterations, residual = self._iterate(right, found)
        return Solution(body.whole((found * self._scale)[body.free]), outcome, iterations, residual)

    def columns(self, unknowns: NDArray[np.int64]) -> Array:
        """Displacements of all unknowns [m/N] for unit forces on some, shape (3n, k); zero for held ones.

        Raises
        ------
        InputError
            If the supports are displaced, or a solve does not converge.
        """
        self.body.require_rest()
        answers = np.zeros((len(self._scale), len(unknowns)))
        for column, unknown in enumerate(unknowns):
            right = np.zeros_like(self._scale)
            right[unknown] = self._scale[unknown]
            found, outcome, _, _ = self._iterate(right, np.zeros_like(right))
            if outcome is not SolverOutcome.CONVERGED:
                raise InputError(f"stiffness must have columns by multigrid, got {outcome.name}: {outcome.value}")
            answers[:, column] = found * self._scale
        return answers

    def _iterate(self, right: Array, found: Array) -> tuple[Array, SolverOutcome, int, float]:
        """Conjugate gradients; Polak and Ribiere's factor forgives a cycle that is not quite symmetric."""
        size = float(np.linalg.norm(right))
        if size == 0.0:
            return np.zeros_like(right), SolverOutcome.CONVERGED, 0, 0.0
        residual = right - self._matrix @ found
        step, before, last, length = np.zeros_like(right), residual, 1.0, 1.0
        diagonal: list[float] = []
        off_diagonal: list[float] = []
        for iteration in range(self._limit + 1):
            corrected = self._cycle @ residual
            slope = float(residual @ corrected)
            left = float(np.linalg.norm(residual)) / size
            if not np.isfinite(slope) or slope < 0.0:
                return found, SolverOutcome.INDEFINITE, iteration, left
            energy = float(found @ (right - residual))  # of the present iterate
            within = self.tolerance**2 * energy
            if diagonal and slope <= within:
                ritz = eigvalsh_tridiagonal(diagonal, off_diagonal[1:])
                self._least = min(self._least, max(float(ritz[0]), LEAST_SHARE))
            if left <= LEAST_SHARE or (energy > 0.0 and slope <= self._least * within):
                return found, SolverOutcome.CONVERGED, iteration, left
            if iteration == self._limit:
                break
            factor = 0.0 if iteration == 0 else max(0.0, float(corrected @ (residual - before)) / last)
            step = corrected + factor * step
            along = self._matrix @ step
            curvature = float(step @ along)
            if not curvature > 0.0:
                return found, SolverOutcome.INDEFINITE, iteration, left
            earlier, length = length, float(residual @ step) / curvature
            diagonal.append(1.0 / length + (factor / earlier if iteration else 0.0))
            off_diagonal.append(np.sqrt(factor) / earlier)
            found = found + length * step
            before, last = residual, slope
            residual = residual - length * along
        return found, SolverOutcome.NOT_CONVERGED, self._limit, left
