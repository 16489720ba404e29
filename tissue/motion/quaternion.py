"""Rotations inside the tick: unit quaternions (x, y, z, w) and rotation vectors [rad] as plain floats."""

from math import atan2, cos, inf, sin, sqrt

__all__ = ["Quaternion", "Triple", "conjugate", "exponential", "logarithm", "product", "turn_between", "unit"]

Quaternion = tuple[float, float, float, float]
Triple = tuple[float, float, float]
"""Three components of a vector."""


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """The rotation ``right`` followed by ``left``."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def conjugate(rotation: Quaternion) -> Quaternion:
    """The inverse rotation."""
    x, y, z, w = rotation
    return -x, -y, -z, w


def unit(rotation: Quaternion) -> Quaternion | None:
    """The quaternion at unit length; None where it has none (zero, infinite or not a number)."""
    x, y, z, w = rotation
    size = sqrt(x * x + y * y + z * z + w * w)
    return (x / size, y / size, z / size, w / size) if 1e-6 < size < inf else None


def exponential(vector: Triple) -> Quaternion:
    """The rotation about ``vector`` by its length."""
    x, y, z = vector
    angle = sqrt(x * x + y * y + z * z)
    share = sin(0.5 * angle) / angle if angle > 1e-8 else 0.5
    return share * x, share * y, share * z, cos(0.5 * angle)


def logarithm(rotation: Quaternion) -> Triple:
    """The shortest rotation vector of a unit quaternion, no longer than pi."""
    x, y, z, w = rotation
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    size = sqrt(x * x + y * y + z * z)
    share = 2.0 * atan2(size, w) / size if size > 1e-12 else 2.0
    return share * x, share * y, share * z


def turn_between(start: Quaternion, goal: Quaternion) -> Triple:
    """Rotation vector [rad] of the shortest turn that brings quaternion ``start`` to ``goal``.

    The logarithm of ``goal start^-1``, in the world's axes; at half a turn one of two equal ones is returned.
    """
    return logarithm(product(goal, conjugate(start)))
