"""Eigenvalues of an operator, and the cap that keeps its powers from growing."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive

__all__ = ["cap_spectrum", "spectral_radius"]


def spectral_radius(matrix: Array) -> float:
    """Largest size of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def cap_spectrum(matrix: Array, limit: float = 1.0) -> tuple[Array, int]:
    """The matrix with eigenvalues larger than `limit` shrunk to that size, and how many were.

    In the real Schur form with the small eigenvalues leading, A = Q T Qᵀ, only the diagonal blocks of the large ones
    are scaled. So what starts in the invariant subspace of the small ones moves exactly as before, their eigenvalues
    stay, frequencies of the large ones too, and the change |A' - A| is no more than what the large eigenvalues
    exceed the limit by (times a block's own departure from normality). Q being orthogonal, no eigenvectors are
    inverted: the condition number of theirs does not enter. Right eigenvectors of the small stay, left ones may turn.
    Several modes capped to one size may share an eigenvector: at 1 they then grow in proportion to the steps, not
    as a power; below 1 they settle.

    Raises
    ------
    InputError
        If the matrix is not finite or the limit is not positive.
    """
    from scipy.linalg import schur

    require_positive("limit", limit, "use 1")
    if not np.isfinite(matrix).all():
        raise InputError("the matrix must be finite to be capped, got NaN or infinity: fit it again with ridge=1e-6")
    if spectral_radius(matrix) <= limit:
        return matrix, 0
    try:
        # SciPy prints an error of its own when a stop is raised in its callback. Python raises stops in the main thread
        # alone, so that the callback runs in another one.
        with ThreadPoolExecutor(1) as pool:
            ordered = pool.submit(schur, matrix, output="real", sort=lambda re, im: re**2 + im**2 <= limit**2)
            triangle, basis, _ = ordered.result()
    except np.linalg.LinAlgError:
        # Eigenvalues too close to the limit to be put in order: the unordered form has the same capped spectrum.
        triangle, basis = schur(matrix, output="real")
    shrunk, capped, row = triangle.copy(), 0, 0
    while row < len(triangle):
        size = 2 if row + 1 < len(triangle) and triangle[row + 1, row] != 0.0 else 1
        block = slice(row, row + size)
        modulus = float(np.abs(np.linalg.eigvals(triangle[block, block])).max())
        if modulus > limit:
            shrunk[block, block] *= limit / modulus
            capped += size
        row += size
    return matrix + basis @ (shrunk - triangle) @ basis.T, capped
