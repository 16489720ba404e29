"""Shape functions of straight-sided simplices, linear and quadratic, in barycentric coordinates.

On a straight simplex the gradients g_c of the barycentric coordinates l_c are constant. The
gradient of shape function A is ``sum_c sum_i slope[A, c, i] l_i g_c``. It is g_A (linear) or ``(4
l_A - 1) g_A`` (quadratic) for a corner, with 1 = sum l_i, and ``4 (l_i g_j + l_j g_i)`` for the
middle of edge ij. Products integrate exactly by ``mean(l_i l_j) = (1 + delta_ij) / ((d + 1) (d +
2))``, so that no quadrature is needed.
"""

import numpy as np

from meshes.base.arrays import Array, Ints

__all__ = [
    "EDGES",
    "TRIANGLE_EDGES",
    "gauss_points",
    "gradient_products",
    "gradient_slopes",
    "mean_shape",
]


EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners of the edges of a tetrahedron in the order of their middle nodes, VTK's order."""

TRIANGLE_EDGES = EDGES[:3]
"""Corners of each edge of a triangle."""

GAUSS = 0.13819660112501052
"""Barycentric coordinate of the four Gauss points that integrate quadratics: (5 - sqrt 5) / 20."""


def gauss_points(order: int) -> Array:
    """Return barycentric coordinates of a tetrahedron's Gauss points, which have equal weights.

    Shape (1, 4) for linear cells, (4, 4) for quadratic cells.
    """
    return np.full((1, 4), 0.25) if order == 1 else GAUSS + (1.0 - 4.0 * GAUSS) * np.eye(4)


def gradient_slopes(corners: int, order: int) -> Array:
    """Return the slopes of the gradients, shape (nodes, corners, corners).

    The axes are shape function, g_c and l_i.
    """
    edges = _edges(corners, order)
    slope = np.zeros((corners + len(edges), corners, corners))
    for a in range(corners):
        slope[a, a] = 1.0 if order == 1 else -1.0
        slope[a, a, a] += 0.0 if order == 1 else 4.0
    for middle, (i, j) in enumerate(edges, start=corners):
        slope[middle, j, i] = slope[middle, i, j] = 4.0
    return slope


def gradient_products(corners: int, order: int) -> Array:
    """Return means of gradient products over the simplex, shape (nodes, nodes, corners, corners).

    [A, B, c, d] multiplies g_c g_d^T.
    """
    slope = gradient_slopes(corners, order)
    mean = (1.0 + np.eye(corners)) / (corners * (corners + 1))
    return np.asarray(np.einsum("aci,bdj,ij->abcd", slope, slope, mean))


def mean_shape(corners: int, order: int) -> Array:
    """Return means of the shape functions over the simplex, shape (nodes,): shares of a uniform
    load.
    """
    if order == 1:
        return np.full(corners, 1.0 / corners)
    middle = 4.0 / (corners * (corners + 1))
    at_corner = 4.0 / (corners * (corners + 1)) - 1.0 / corners
    return np.concatenate(
        [np.full(corners, at_corner), np.full(len(_edges(corners, order)), middle)]
    )


def _edges(corners: int, order: int) -> Ints:
    if order == 1:
        return EDGES[:0]
    return EDGES if corners == 4 else TRIANGLE_EDGES
