"""SuperLU of scipy on the symmetric pattern with diagonal pivots, in the order given: also of indefinite matrices."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from meshes.base.arrays import Array

__all__ = ["SuperLUFactor"]


class SuperLUFactor:
    """A factor of a symmetric matrix, made once.

    Parameters
    ----------
    matrix
        In order of elimination, shape (n, n).

    Raises
    ------
    RuntimeError
        If the matrix is singular.
    """

    def __init__(self, matrix: csc_array) -> None:
        self._factor = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(self, right: Array) -> Array:
        """The solution for one or several right sides, shape (n,) or (n, m)."""
        found: Array = self._factor.solve(np.asfortranarray(right))
        return found

    def inverse_of_last(self, count: int) -> Array:
        """Rows and columns of the inverse that belong to the last unknowns, shape (count, count)."""
        upper = self._factor.U[-count:, -count:].toarray()
        # S = U^T D^-1 U with D the diagonal of U: its inverse is V D V^T with V the inverse of U.
        # D has negative entries where the matrix is indefinite.
        pivots = np.diag(upper)
        half = solve_triangular(upper, np.diag(np.sqrt(np.abs(pivots))))
        whole: Array = (half * np.sign(pivots)) @ half.T
        return whole
