"""The site frame of a tooth found from its shape: long axis, crown upward, roots' plane.

The long axis is the principal axis of all the tooth's points that leans least from the line between the middles of
dentin and enamel; where none comes within 25 degrees of that line (a crown without roots), the line itself.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

__all__ = ["ToothAxes", "tooth_axes"]

_LEAST_RISE_M = 0.4e-3
_MOST_LEANING = math.cos(math.radians(25.0))


@dataclass(frozen=True, eq=False)
class ToothAxes:
    """Orientation of a tooth.

    Attributes
    ----------
    rotation
        Site axes as columns in the frame of the points, shape (3, 3), right-handed: z from the roots to the crown, x
        along the widest direction across the lower half (mesiodistal where there are two roots, its sign unknown).
    middle_m
        Middle of the enamel [m], shape (3,); the site's origin lies above or below it along z.
    note
        How the long axis was found, a sentence.
    """

    rotation: NDArray[np.float64]
    middle_m: NDArray[np.float64]
    note: str


def tooth_axes(enamel_m: NDArray[np.float64], body_m: NDArray[np.float64]) -> ToothAxes:
    """Orientation of a tooth from points spread evenly over its enamel and over the rest of it.

    Parameters
    ----------
    enamel_m, body_m
        Points of the enamel, and of dentin, pulp and ligament [m], shapes (n, 3) and (m, 3).

    Raises
    ------
    InputError
        If the enamel does not lie to one side of the rest.
    """
    middle = enamel_m.mean(axis=0)
    rise = middle - body_m.mean(axis=0)
    height = float(np.linalg.norm(rise))
    if height < _LEAST_RISE_M:
        raise InputError(
            "layers",
            "have the enamel to one side of the dentin",
            f"middles {1e3 * height:.2g} mm apart",
            "check which layer is which",
        )
    line = rise / height
    whole = np.concatenate([enamel_m, body_m])
    principal = np.linalg.eigh(np.cov(whole.T))[1]
    along = principal.T @ line
    chosen = int(np.argmax(np.abs(along)))
    leaning = math.degrees(math.acos(min(abs(float(along[chosen])), 1.0)))
    if abs(along[chosen]) > _MOST_LEANING:
        up = principal[:, chosen] * np.sign(along[chosen])
        note = f"principal axis, {leaning:.0f} degrees from the line between the middles of dentin and enamel"
    else:
        up = line
        note = f"line between the middles of dentin and enamel; the principal axes lean {leaning:.0f} degrees or more"
    x = _widest(body_m, up)
    return ToothAxes(np.column_stack([x, np.cross(up, x), up]), middle, note)


def _widest(points: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector across `up` along which the lower half of the points spreads most."""
    offset = points - points.mean(axis=0)
    lower = offset[offset @ up < 0.0]
    across = lower - np.outer(lower @ up, up)
    direction = np.linalg.eigh(np.cov(across.T))[1][:, 2]
    direction = direction - (direction @ up) * up
    direction /= np.linalg.norm(direction)
    return direction * (1.0 if direction[int(np.argmax(np.abs(direction)))] > 0.0 else -1.0)
