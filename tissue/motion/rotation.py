"""Between the rotations of a tool, matrices, and those of a device and its proxy, unit quaternions (x, y, z, w)."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tissue.motion.quaternion import Quaternion, conjugate, logarithm, product

__all__ = ["matrix_of", "quaternion_of", "turn_between"]

Array = NDArray[np.float64]


def turn_between(start: Array, goal: Array) -> Array:
    """Rotation vector [rad] of the shortest turn that brings quaternion ``start`` to ``goal``, shape (3,).

    The logarithm of ``goal start^-1``, in the world's axes; at half a turn one of two equal ones is returned.
    """
    return np.array(logarithm(product(_four(goal), conjugate(_four(start)))))


def matrix_of(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion, shape (3, 3)."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion with w >= 0 of a rotation matrix, shape (3, 3).

    From the largest of its four components, so that no small number is divided by (Shepperd 1978, J. Guid. Control
    1:223).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    largest = squares.index(max(squares))
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    quaternion = np.array(rows[largest]) / (2.0 * sqrt(squares[largest]))
    return quaternion if quaternion[3] >= 0.0 else -quaternion


def _four(quaternion: Array) -> Quaternion:
    x, y, z, w = quaternion.tolist()
    return x, y, z, w
