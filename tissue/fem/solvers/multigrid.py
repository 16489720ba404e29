"""Conjugate gradients preconditioned by smoothed aggregation with the six rigid motions.

The solver is for large meshes: its memory, and its time for one right-hand side, increase linearly
with the number of unknowns. The matrix is scaled by its diagonal, so that cells of all sizes have
equal weight. The matrix is stored in blocks of 3x3, so that whole nodes are aggregated instead of
single components (Vanek, Mandel, Brezina 1996, Computing 56:179).
"""

import warnings
from dataclasses import replace

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal
from scipy.sparse import bsr_matrix, diags_array

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import (
    LEAST_SHARE,
    Iterate,
    Solution,
    conjugate_gradients,
    dot,
)
from tissue.fem.solvers.held_body import HeldBody, rigid_modes

COARSEST_NODES = 50
"""Largest number of aggregates (groups of nodes) of a level that is solved directly.

With 10 to 400 aggregates, livers of 2505 and 16,523 nodes take 18 to 20 iterations.
"""
WEAK = 0.05
"""Smallest coupling of two nodes that are aggregated, relative to the stiffness of the nodes.

Without this limit, 1.5 times as many iterations are needed.
"""


class MultigridSolver:
    """Iterative solver with a multigrid preconditioner that is set up once.

    Parameters
    ----------
    body
        The stiffness and its supports.
    tolerance
        Allowed energy norm of the error, divided by the energy norm of the displacement. The error
        is estimated as ``sqrt(r . B r / l)``. Here r is the residual, B is a multigrid cycle, and l
        is the smallest eigenvalue of B K found in the iterations (Meurant and Strakos 2006, Acta
        Numer. 15:471).
    limit
        Largest number of iterations. A liver mesh needs 20 iterations. If a body needs many more
        iterations, the multigrid cycle is not suitable for this body.
    """

    def __init__(self, body: HeldBody, *, tolerance: float = 1e-8, limit: int = 500) -> None:
        from pyamg import smoothed_aggregation_solver

        self.tolerance = tolerance
        self.body = body
        self._limit = limit
        self._free = np.zeros(3 * len(body.nodes_m), np.bool_)
        self._free[body.free] = True
        diagonal = body.stiffness.diagonal()
        self._scale = np.where(self._free, 1.0 / np.sqrt(np.where(self._free, diagonal, 1.0)), 0.0)
        self._matrix = self._scaled()
        modes = rigid_modes(body.nodes_m, body.nodes_m.mean(axis=0)).reshape(-1, 6)
        size = np.abs(modes).max(axis=0)
        near_null = np.divide(
            modes / size, self._scale[:, None], out=np.zeros_like(modes), where=self._free[:, None]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on small coarse grids, pyamg warns about their rank
            self._hierarchy = smoothed_aggregation_solver(
                self._matrix,
                B=near_null,
                strength=("symmetric", {"theta": WEAK}),
                max_coarse=COARSEST_NODES,
                improve_candidates=None,
            )
        self._cycle = self._hierarchy.aspreconditioner(cycle="V")
        self._least = 1.0

    def _scaled(self) -> bsr_matrix:
        """Return D^-1/2 K D^-1/2, with the identity at held components.

        The indices have 32 bits, as pyamg requires.
        """
        scale = diags_array(self._scale)
        scaled = (scale @ self.body.stiffness @ scale + diags_array(1.0 - self._free)).tobsr((3, 3))
        indices = scaled.indices.astype(np.int32)
        starts = scaled.indptr.astype(np.int32)
        return bsr_matrix((scaled.data, indices, starts), shape=scaled.shape)

    def solve(self, load_N: Array) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3)."""
        body = self.body
        right = np.zeros(len(self._scale))
        right[body.free] = body.right_side(load_N)
        found = self._iterate(right * self._scale)
        return replace(
            found, displacement_m=body.whole((found.displacement_m * self._scale)[body.free])
        )

    def columns(self, unknowns: Ints) -> Array:
        """Return the displacements [m/N] under a unit force on each of k unknowns, shape (3n, k).

        Rows of held unknowns are zero.

        Raises
        ------
        InputError
            If the iterations for a column do not converge.
        """
        answers = np.zeros((len(self._scale), len(unknowns)))
        for column, unknown in enumerate(unknowns):
            right = np.zeros_like(self._scale)
            right[unknown] = self._scale[unknown]
            found = self._iterate(right)
            if not found.converged:
                name = found.outcome.name
                remedy = found.outcome.value
                raise InputError(
                    "stiffness", "allow multigrid to converge", f"the outcome {name}", remedy
                )
            answers[:, column] = found.displacement_m * self._scale
        return answers

    def _iterate(self, right: Array) -> Solution:
        """Solve with the scaled matrix by conjugate gradients."""
        return conjugate_gradients(
            lambda u: self._matrix @ u,
            right,
            precondition=lambda r: self._cycle @ r,
            error=lambda now: self._error(now, right),
            tolerance=self.tolerance,
            limit=self._limit,
        )

    def _error(self, now: Iterate, right: Array) -> float:
        """Estimate the relative error in the energy norm.

        If the error may be within the tolerance, the smallest eigenvalue is estimated again.
        """
        energy = dot(now.found, right - now.residual)
        slope = now.slopes[-1]
        # At the start the displacement has no energy to compare the error with.
        if energy <= 0.0:
            return np.inf
        if now.lengths and slope <= self.tolerance**2 * energy:
            factor = np.array(now.factors)
            length = np.array(now.lengths)
            earlier = np.append(1.0, length[:-1])
            ritz = eigvalsh_tridiagonal(
                1.0 / length + factor / earlier, (np.sqrt(factor) / earlier)[1:]
            )
            self._least = min(self._least, max(float(ritz[0]), LEAST_SHARE))
        return float(np.sqrt(slope / (self._least * energy)))
