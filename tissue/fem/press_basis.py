"""A basis of a pressed body: what the linear body does under the forces seen, and what large strains add.

Both parts are proper orthogonal decompositions in the energy of the stiffness at rest. The linear answers must be in
it: a contact adds the linear answer of what the basis misses, and would add twice what large strains have changed.
"""

import numpy as np
from scipy.sparse import bsr_array, csr_array

from meshes.base.arrays import Array

__all__ = ["press_basis"]

LEAST = 1e-10
"""Energy of a mode over that of the first below which it is rounding."""


def press_basis(stiffness: bsr_array, linear_m: Array, moved_m: Array, size: int) -> Array:
    """Modes [m/sqrt(J)], orthonormal in the stiffness, at most so many, half of each part, shape (3n, r).

    Parameters
    ----------
    stiffness
        At rest [N/m], shape (3n, 3n).
    linear_m, moved_m
        Displacements of the linear and of the real body under the same forces [m], shapes (3n, s).
    size
        Most modes.
    """
    matrix = stiffness.tocsr()
    first = _leading(matrix, _evened(matrix, linear_m), size - size // 2)
    even = _evened(matrix, moved_m)
    second = _leading(matrix, even - first @ (first.T @ (matrix @ even)), size - first.shape[1])
    return np.concatenate([first, second], axis=1)


def _evened(matrix: csr_array, moved_m: Array) -> Array:
    """Displacements over the root of their size, so that shallow ones count too."""
    energy = np.einsum("us,us->s", moved_m, matrix @ moved_m)
    return moved_m / np.where(energy > 0.0, energy, 1.0) ** 0.25


def _leading(matrix: csr_array, moved_m: Array, size: int) -> Array:
    """Leading modes of displacements, orthonormal in a matrix."""
    gram = moved_m.T @ (matrix @ moved_m)
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    kept = np.flatnonzero(values > LEAST * values[-1])[::-1][:size]
    return np.asarray(moved_m @ (vectors[:, kept] / np.sqrt(values[kept])))
