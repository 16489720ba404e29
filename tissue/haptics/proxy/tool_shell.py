"""A tool of any shape as points on its surface."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from tissue.cutters.cutter import Cutter

__all__ = ["ToolShell"]


@dataclass(frozen=True, eq=False)
class ToolShell:
    """Points of a tool's surface in the tool's frame: origin at the tip, z from the tip to the shank.

    Attributes
    ----------
    points_m
        Positions [m], shape (n, 3).
    normals
        Outward unit normals, shape (n, 3); zero where a point has none.
    radius_m
        Radius of a ball around every point [m]. Several balls are a tool that is exact on solids; on voxels only points
        are felt.

    Raises
    ------
    InputError
        If there is no point, a number is not finite, the shapes differ or a normal is neither of length 1 nor 0.
    """

    points_m: Array
    normals: Array
    radius_m: float = 0.0

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points_m, dtype=np.float64)
        normals = np.ascontiguousarray(self.normals, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
            raise InputError(
                f"points_m must be finite, of shape (n, 3), got shape {points.shape}: give rows of x, y, z"
            )
        if normals.shape != points.shape:
            raise InputError(
                f"normals must have the shape of points_m {points.shape}, got {normals.shape}: one a point"
            )
        lengths = np.linalg.norm(normals, axis=1)
        if not ((np.abs(lengths - 1.0) < 1e-6) | (lengths == 0.0)).all():
            raise InputError("normals must have length 1, or 0 where there is none, got others: divide by their length")
        require_range("radius_m", self.radius_m, 0.0, 1.0, "use 0 for points")
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "normals", normals)

    @classmethod
    def ball(cls, radius_m: float = 0.0, *, centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> "ToolShell":
        """One exact ball of ``radius_m`` [m], or with radius 0 the point of the classical god-object."""
        return cls(np.array([centre_m], dtype=np.float64), np.zeros((1, 3)), radius_m)

    @classmethod
    def of_cutter(cls, cutter: Cutter, *, point_count: int = 700) -> "ToolShell":
        """About ``point_count`` points over the cutting surface of a cutter."""
        require_positive("point_count", point_count, "use about 700")
        shell = cutter.shell(spacing_m=(cutter.cutting_area_m2 / point_count) ** 0.5)
        return cls(shell.points_m, shell.normals)

    @property
    def reach_m(self) -> float:
        """Greatest distance of the surface from the tool's origin [m]."""
        return float(np.linalg.norm(self.points_m, axis=1).max()) + self.radius_m
