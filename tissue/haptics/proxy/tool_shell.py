"""Tool of any shape as points on its surface."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.cutters.cutter import Cutter

__all__ = ["ToolShell"]


@dataclass(frozen=True, eq=False)
class ToolShell:
    """Surface points of a tool in its own frame: origin at the tip, z from tip to shank.

    Attributes
    ----------
    points_m
        Positions [m], shape (n, 3).
    normals
        Outward unit normals, shape (n, 3); zero where a point has no normal.
    radius_m
        Radius of a ball around every point [m]. A tool of several balls is exact on solids. Voxels
        are tested only against points.
    """

    points_m: Array
    normals: Array
    radius_m: float = 0.0

    @classmethod
    def ball(
        cls, radius_m: float = 0.0, *, centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> "ToolShell":
        """Return one exact ball of ``radius_m`` [m].

        With radius 0, it is the point of the classical god-object.
        """
        return cls(np.array([centre_m], dtype=np.float64), np.zeros((1, 3)), radius_m)

    @classmethod
    def of_cutter(cls, cutter: Cutter, *, point_count: int = 700) -> "ToolShell":
        """Return about ``point_count`` points over the cutting surface of a cutter."""
        shell = cutter.shell(spacing_m=(cutter.cutting_area_m2 / point_count) ** 0.5)
        return cls(shell.points_m, shell.normals)

    @property
    def reach_m(self) -> float:
        """Largest distance of the surface from the tool's origin [m]."""
        return float(np.linalg.norm(self.points_m, axis=1).max()) + self.radius_m
