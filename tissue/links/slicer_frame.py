"""Frame of a scene in 3D Slicer, which uses RAS; anatomy files use LPS."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.placement import Placement

__all__ = ["SlicerFrame"]

Array = NDArray[np.float64]
LPS_TO_RAS: Array = np.diag([-1.0, -1.0, 1.0])
"""Rotation by half a turn from LPS to RAS: left and back become right and front."""


class SlicerFrame:
    """Rigid transform between the scene frame [mm] and RAS [mm].

    A scene whose anatomy comes from a file is aligned with that file. Any other scene has no
    patient frame. It is placed where 3D Slicer shows the files of its run, such as ``bone.nrrd``,
    which 3D Slicer interprets as LPS.

    Parameters
    ----------
    placement
        Placement of the scene frame in the frame of the file; None for a scene without a file.
    """

    def __init__(self, placement: Placement | None) -> None:
        turn = np.eye(3) if placement is None else placement.rotation
        origin = np.zeros(3) if placement is None else placement.origin_mm
        self._turn: Array = LPS_TO_RAS @ turn
        self._origin: Array = LPS_TO_RAS @ origin

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix from the scene [mm] to RAS [mm], shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._turn
        matrix[:3, 3] = self._origin
        return matrix

    def points(self, points_mm: ArrayLike) -> Array:
        """Return points of the scene [mm], shape (n, 3), in RAS [mm]."""
        return np.asarray(points_mm, dtype=np.float64) @ self._turn.T + self._origin

    def vector(self, vector: ArrayLike) -> Array:
        """Return a force, a torque or another vector of the scene in RAS, shape (3,)."""
        return np.asarray(self._turn @ np.asarray(vector, dtype=np.float64))

    def pose(self, tip_mm: ArrayLike, rotation: ArrayLike) -> Array:
        """Return the matrix from a tool frame to RAS [mm], shape (4, 4).

        The arguments are the tip [mm] and the orientation, shape (3, 3), in the scene.
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self._turn @ np.asarray(rotation, dtype=np.float64)
        matrix[:3, 3] = self.points(np.reshape(tip_mm, (1, 3)))[0]
        return matrix

    def pose_in_scene(self, matrix: ArrayLike) -> tuple[Array, Array]:
        """Return tip [mm] and orientation, shape (3, 3), in the scene from a tool pose in RAS.

        The pose is a homogeneous matrix [mm], shape (4, 4).
        """
        given = np.asarray(matrix, dtype=np.float64)
        return self._turn.T @ (given[:3, 3] - self._origin), self._turn.T @ given[:3, :3]
