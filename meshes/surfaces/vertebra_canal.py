"""The canal of a vertebra as the hole that is seen through it, and the vertebra's own directions by it.

A bone that is looked at along its canal has a hole in its shadow; of all directions the one with the largest hole is
the canal's. The body is the larger part and lies in front of it; the arch behind hangs lower than the body.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Canal", "canals"]

_PIXEL_M = 1.0e-3
_DIRECTIONS, _FINER = 300, 60
_AREA_M2 = (40e-6, 900e-6)
"""Canals are 13 to 20 mm by 18 to 32 mm, 150 to 450 mm2; seen straight through 17 real vertebrae are 50 to 90 of it."""
_FINE = np.radians((12.0, 4.0))


@dataclass(frozen=True, eq=False)
class Canal:
    """A hole through a bone.

    Attributes
    ----------
    axis
        Unit vector along it, sign arbitrary, shape (3,).
    point_m
        A point on its axis [m], shape (3,).
    area_m2
        Area of the hole seen along the axis [m2].
    """

    axis: NDArray[np.float64]
    point_m: NDArray[np.float64]
    area_m2: float


def canals(points: NDArray[np.float64]) -> list[Canal]:
    """Holes through a bone of plausible size, the largest first, each at least 40 degrees from a larger one.

    Parameters
    ----------
    points
        Points all over and within the bone [m], shape (n, 3), one or more for each millimetre of its shadow.
    """
    views = [_seen(points, axis) for axis in _hemisphere(_DIRECTIONS)]
    open_views = sorted((view for view in views if view.area_m2 > 0.0), key=lambda view: -view.area_m2)
    found: list[Canal] = []
    for view in open_views:
        if all(abs(view.axis @ other.axis) < 0.75 for other in found):
            best = view
            for spread in _FINE:
                around = [_seen(points, axis) for axis in _cone(best.axis, float(spread))]
                best = max([best, *around], key=lambda each: each.area_m2)
            found.append(_centred(points, best))
        if len(found) == 3:
            break
    return sorted((each for each in found if _AREA_M2[0] < each.area_m2 < _AREA_M2[1]), key=lambda each: -each.area_m2)


def _seen(points: NDArray[np.float64], axis: NDArray[np.float64]) -> Canal:
    """The largest hole in the shadow along a direction."""
    from scipy.ndimage import binary_closing, binary_fill_holes, label

    u, v = _across(axis)
    flat = np.column_stack([points @ u, points @ v])
    low = flat.min(axis=0) - 3.0 * _PIXEL_M
    at = np.floor((flat - low) / _PIXEL_M).astype(int)
    shadow = np.zeros(at.max(axis=0) + 4, dtype=bool)
    shadow[tuple(at.T)] = True
    shadow = binary_closing(shadow)
    holes, count = label(binary_fill_holes(shadow) & ~shadow)
    if count == 0:
        return Canal(axis, points[0], 0.0)
    sizes = np.bincount(holes.ravel())[1:]
    number = int(np.argmax(sizes)) + 1
    middle = low + _PIXEL_M * (np.argwhere(holes == number).mean(axis=0) + 0.5)
    level = float(np.median(points @ axis))
    return Canal(axis, middle[0] * u + middle[1] * v + level * axis, float(sizes[number - 1]) * _PIXEL_M**2)


def _centred(points: NDArray[np.float64], canal: Canal) -> Canal:
    """The mean of the directions around in which the hole is at least 0.9 times as large."""
    views = [_seen(points, axis) for axis in _cone(canal.axis, float(_FINE[0]))]
    wide = [view for view in [canal, *views] if view.area_m2 > 0.9 * canal.area_m2]
    axis = np.sum([view.axis * np.sign(view.axis @ canal.axis) for view in wide], axis=0)
    return _seen(points, axis / np.linalg.norm(axis))


def _across(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def _hemisphere(count: int) -> NDArray[np.float64]:
    """Evenly spread directions with z >= 0, shape (count, 3)."""
    height = (np.arange(count) + 0.5) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), height])


def _cone(axis: NDArray[np.float64], spread: float) -> NDArray[np.float64]:
    """Directions within an angle [rad] of an axis, shape (60, 3)."""
    u, v = _across(axis)
    number = np.arange(_FINER) + 0.5
    lean = spread * np.sqrt(number / _FINER)
    angle = np.pi * (1.0 + np.sqrt(5.0)) * number
    return (
        np.cos(lean)[:, None] * axis
        + (np.sin(lean) * np.cos(angle))[:, None] * u
        + (np.sin(lean) * np.sin(angle))[:, None] * v
    )
