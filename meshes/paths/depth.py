"""How deep below a bone's surface a path leads."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.paths.toolpath import Toolpath
from meshes.surfaces.surface import Surface
from meshes.voxels.column_crossings import inside_scattered
from meshes.voxels.mesh_sampling import triangle_distance

__all__ = ["PathDepth", "depth_along"]

_STEP_MM = 0.5
_MOST_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class PathDepth:
    """Depth along a path.

    Attributes
    ----------
    points_mm
        The path's points and others between them, at most 0.5 mm apart [mm, LPS], shape (n, 3).
    depth_mm
        Distance of each from the bone's surface [mm], shape (n,), positive inside the bone and negative outside.
    """

    points_mm: Array
    depth_mm: Array

    @property
    def deepest_mm(self) -> float:
        """Greatest depth [mm]; negative where the path never enters the bone."""
        return float(self.depth_mm.max())

    @property
    def share_inside(self) -> float:
        """Share of the path's points that lie in the bone."""
        return float((self.depth_mm > 0.0).mean())


def depth_along(path: Toolpath, surface: Surface) -> PathDepth:
    """Depth of a path's tip below a bone's surface, before anything is cut."""
    points = _densified(path.points_mm)
    distance = np.abs(triangle_distance(surface.vertices_m, surface.faces, 1e-3 * points))
    inside = inside_scattered(surface.vertices_m, surface.faces, 1e-3 * points)
    return PathDepth(points, 1e3 * np.where(inside, distance, -distance))


def _densified(points_mm: Array) -> Array:
    """Points on the lines between points, all given ones among them; farther apart where there were very many."""
    length = np.linalg.norm(np.diff(points_mm, axis=0), axis=1)
    step = max(_STEP_MM, float(length.sum()) / _MOST_POINTS)
    parts = [
        first + np.arange(count)[:, None] / count * (last - first)
        for first, last, count in zip(
            points_mm[:-1], points_mm[1:], np.maximum(np.ceil(length / step), 1.0).astype(int).tolist(), strict=True
        )
    ]
    return np.vstack([*parts, points_mm[-1:]])
