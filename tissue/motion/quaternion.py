"""Fast rotations: unit quaternions (x, y, z, w) and rotation vectors [rad], as Python floats."""

from collections.abc import Sequence
from math import atan2, cos, inf, sin, sqrt

Quaternion = tuple[float, float, float, float]
Triple = tuple[float, float, float]
"""Three components of a vector."""
NOTHING: Triple = (0.0, 0.0, 0.0)
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
"""Quaternion of the identity rotation; `NOTHING` is the zero vector."""
OFF_UNIT = 0.02
"""Largest accepted deviation of a quaternion's squared length from 1.

Rounding of all four components to two decimals changes the squared length by up to 0.02.
"""


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Return the product ``left right``, which rotates first by ``right`` and then by ``left``."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def conjugate(rotation: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    x, y, z, w = rotation
    return -x, -y, -z, w


def unit(rotation: Quaternion) -> Quaternion | None:
    """Return the quaternion scaled to unit length; None if its length is zero, infinite or NaN."""
    x, y, z, w = rotation
    size = sqrt(x * x + y * y + z * z + w * w)
    # Below 1e-6, rounding in single precision would determine the direction.
    return (x / size, y / size, z / size, w / size) if 1e-6 < size < inf else None


def is_nearly_unit(rotation: Quaternion) -> bool:
    """Return True if the squared length of the quaternion deviates from 1 by at most `OFF_UNIT`."""
    x, y, z, w = rotation
    return abs(x * x + y * y + z * z + w * w - 1.0) <= OFF_UNIT


def exponential(vector: Triple) -> Quaternion:
    """Return the quaternion of a rotation vector: axis times angle [rad]."""
    x, y, z = vector
    angle = sqrt(x * x + y * y + z * z)
    # Below 1e-8 rad the series 1/2 - angle^2 / 48 equals 1/2 within rounding.
    share = sin(0.5 * angle) / angle if angle > 1e-8 else 0.5
    return share * x, share * y, share * z, cos(0.5 * angle)


def logarithm(rotation: Quaternion) -> Triple:
    """Return the rotation vector of a unit quaternion [rad], with a length of pi or less."""
    x, y, z, w = rotation
    # The opposite quaternion is the same rotation; the quaternion with w >= 0 gives the smaller
    # angle.
    if w < 0.0:
        x = -x
        y = -y
        z = -z
        w = -w
    size = sqrt(x * x + y * y + z * z)
    # Below 1e-12 the quotient equals 2 within rounding; without rotation it would be 0 / 0.
    share = 2.0 * atan2(size, w) / size if size > 1e-12 else 2.0
    return share * x, share * y, share * z


def turn_between(start: Quaternion, goal: Quaternion) -> Triple:
    """Return the rotation vector [rad] of the shortest rotation from ``start`` to ``goal``.

    The vector is the logarithm of ``goal start^-1``, with components along the world's axes. For
    half a turn there are two shortest rotations; one of them is returned.
    """
    return logarithm(product(goal, conjugate(start)))


def of_matrix(rows: Sequence[Sequence[float]]) -> Quaternion:
    """Return the unit quaternion with w >= 0 of the rotation matrix with the given rows.

    The largest of the four components is computed first, which avoids division by a small number
    (Shepperd 1978, J. Guid. Control 1:223).
    """
    (a, b, c), (d, e, f), (g, h, i) = rows
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    largest = squares.index(max(squares))
    quadruples = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    x, y, z, w = quadruples[largest]
    size = 2.0 * sqrt(squares[largest])
    if w < 0.0:
        size = -size
    return x / size, y / size, z / size, w / size
