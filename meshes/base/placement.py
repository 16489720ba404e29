"""Position of a scene's frame in the frame of the file that contains the anatomy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Floats
from meshes.base.errors import InputError

_ORTHONORMAL = 1e-6
"""Largest deviation of R R^T from the identity matrix for a valid rotation matrix R.

With this deviation, a point at a distance of 1 m has a position error of about 1 um.
"""


@dataclass(frozen=True, eq=False)
class Placement:
    """Rigid transform between a file's frame and the scene's frame, and length unit of the file.

    For a surface, the file's frame is the frame of the stored coordinates. For an image, it is the
    patient frame (LPS).

    Attributes
    ----------
    origin_mm
        Origin of the scene [mm], shape (3,), in the file's frame.
    rotation
        Matrix, shape (3, 3), whose columns are the scene's axes in the file's frame. The axes are
        right-handed.
    unit_mm
        Length unit of the file [mm].
    """

    origin_mm: Array
    rotation: Array
    unit_mm: float = 1.0

    @property
    def file_to_scene_mm(self) -> Array:
        """Return the homogeneous matrix from the file's frame to the scene's frame.

        Lengths in the two frames are in mm. The matrix has the shape (4, 4).
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation.T
        matrix[:3, 3] = -self.rotation.T @ self.origin_mm
        return matrix

    def to_file(self, points_mm: Floats) -> Array:
        """Convert points of the scene [mm], shape (n, 3), to the file's frame and unit."""
        return (
            self.origin_mm + np.asarray(points_mm, dtype=np.float64) @ self.rotation.T
        ) / self.unit_mm

    def to_scene(self, points: Floats) -> Array:
        """Convert points in the file's frame and unit, shape (n, 3), to the scene's frame [mm]."""
        return (
            np.asarray(points, dtype=np.float64) * self.unit_mm - self.origin_mm
        ) @ self.rotation

    def to_record(self) -> dict[str, Any]:
        """Return the transform matrix and the unit as plain numbers, for the summary of a run."""
        return {
            "file_to_scene_mm": self.file_to_scene_mm.tolist(),
            "file_unit_mm": float(self.unit_mm),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Placement:
        """Read a placement from a run's summary.

        Raises
        ------
        InputError
            If the record does not contain a rigid transform and a unit.
        """
        try:
            matrix = np.array(record["file_to_scene_mm"], dtype=np.float64)
            unit = float(record["file_unit_mm"])
            turn = matrix[:3, :3]
            rigid = (
                matrix.shape == (4, 4)
                and np.isfinite(matrix).all()
                and np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
                and np.abs(turn @ turn.T - np.eye(3)).max() < _ORTHONORMAL
                and np.linalg.det(turn) > 0.0
            )
        except (KeyError, TypeError, ValueError, IndexError):
            rigid = False
            unit = 0.0
        if not (rigid and np.isfinite(unit) and unit > 0.0):
            raise InputError(
                "placement",
                "have the keys file_to_scene_mm (a rigid 4 x 4 transformation) and file_unit_mm",
                f"{record!r:.200}",
                "run the scene again",
            )
        return cls(-turn.T @ matrix[:3, 3], turn.T, unit)
