"""Reduced basis: the few shapes that a touched surface mostly takes.

Proper orthogonal decomposition, in the energy norm, of the displacements for all unit forces on the
touchable nodes. Their Gram matrix is the compliance W itself. With ``W = V L V^T`` the modes are
``U V L^-1/2``, where U are the displacements. The modes are orthonormal in K. The reduced
compliance is W cut to its largest eigenvalues, the best matrix of its rank (Eckart and Young 1936,
Psychometrika 1:211). The part left out yields mostly at the touched nodes. Its blocks at single
nodes replace it, like the residual flexibility for omitted modes (MacNeal 1971, Comput. Struct.
1:581).
"""

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import Solution, SolverOutcome
from tissue.fem.solvers.held_body import ColumnSolver, HeldBody

__all__ = ["ReducedSolver"]

CHUNK = 96
"""Number of columns computed at once."""


class ReducedSolver:
    """Solver in a basis of K-orthonormal modes: two products a solve.

    Parameters
    ----------
    solver
        Solver for the displacements under unit forces.
    touchable
        Nodes that carry load, shape (t,).
    size
        Number of modes, at most 3t.
    tolerance
        Largest relative error in the energy norm of a converged solution.

    Raises
    ------
    InputError
        If the size is not in [1, 3t].
    """

    def __init__(
        self, solver: ColumnSolver, touchable: Ints, *, size: int, tolerance: float = 0.1
    ) -> None:
        self.body: HeldBody = solver.body
        self.touchable = np.asarray(touchable, dtype=np.int64)
        rows = (3 * self.touchable[:, None] + np.arange(3)).ravel()
        if not 1 <= size <= len(rows):
            raise InputError(
                "size", f"be in [1, {len(rows)}]", size, "three modes a touchable node are all"
            )
        self.tolerance = tolerance
        parts = [
            solver.columns(rows[start : start + CHUNK]) for start in range(0, len(rows), CHUNK)
        ]
        answers = np.concatenate(parts, axis=1)
        self._rows = rows
        whole = answers[rows]
        self._whole = 0.5 * (whole + whole.T)
        values, vectors = np.linalg.eigh(self._whole)
        self.values_m_N = values[::-1].clip(min=0.0)
        """Eigenvalues of W [m/N], falling, shape (3t,)."""
        self._vectors = vectors[:, ::-1]
        kept = int((self.values_m_N > 1e-13 * self.values_m_N[0]).sum())
        self.size = min(size, kept)
        """Number of modes; smaller than requested where touchable components are held."""
        leading = self._vectors[:, : self.size] / np.sqrt(self.values_m_N[: self.size])
        self.modes = answers @ leading
        """Modes [m/sqrt(J)], orthonormal in K, shape (3n, k)."""
        self._carries = np.zeros(len(answers), dtype=np.bool_)
        self._carries[rows] = True

    def solve(self, load_N: Array, *, start_m: Array | None = None) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3); ``start_m`` is ignored.

        For loads on touchable nodes the error in the energy norm is known, from W over the omitted
        modes. Every other load has the outcome OUTSIDE_BASIS, with a relative error of 1.
        """
        right = self.body.right_side(load_N)
        flat = self.body.whole(right).ravel()
        amount = self.modes.T @ flat
        displacement = (self.modes @ amount).reshape(-1, 3)
        if not right.any():
            return Solution(displacement, SolverOutcome.CONVERGED, 0, 0.0)
        if flat[~self._carries].any():
            return Solution(displacement, SolverOutcome.OUTSIDE_BASIS, 0, 1.0)
        energies = self.values_m_N * (self._vectors.T @ flat[self._rows]) ** 2
        error = float(np.sqrt(energies[self.size :].sum() / energies.sum()))
        outcome = (
            SolverOutcome.CONVERGED if error <= self.tolerance else SolverOutcome.OUTSIDE_BASIS
        )
        return Solution(displacement, outcome, 0, error)

    def compliance_m_N(self, size: int | None = None) -> Array:
        """Return W in the basis [m/N] with residual blocks at each node, shape (3t, 3t).

        It is symmetric.
        """
        cut = self._cut(self.size if size is None else size)
        nodes = np.arange(len(self.touchable))
        view = cut.reshape(len(nodes), 3, len(nodes), 3)
        view[nodes, :, nodes, :] = self._whole.reshape(view.shape)[nodes, :, nodes, :]
        return 0.5 * (cut + cut.T)

    def _cut(self, size: int) -> Array:
        leading = self._vectors[:, :size]
        return (leading * self.values_m_N[:size]) @ leading.T
