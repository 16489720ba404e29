"""Where a scene lies in 3D Slicer, whose frame is RAS; that of files of anatomies is LPS."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.placement import Placement

__all__ = ["SlicerFrame"]

Array = NDArray[np.float64]
LPS_TO_RAS: Array = np.diag([-1.0, -1.0, 1.0])
"""To the left and to the back become to the right and to the front; a rotation by half a turn."""


class SlicerFrame:
    """A rigid motion from the scene's frame [mm] to RAS [mm], and back.

    A scene whose anatomy comes from a file lies on that file. Another one, whose frame is that of
    no patient, lies where 3D Slicer puts the files of its run, such as ``bone.nrrd``, which it
    takes as LPS.

    Parameters
    ----------
    placement
        Where the scene's frame lies in that of the file; None for a scene without one.
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
        """Points of the scene [mm], shape (n, 3), in RAS [mm]."""
        return np.asarray(points_mm, dtype=np.float64) @ self._turn.T + self._origin

    def vector(self, vector: ArrayLike) -> Array:
        """A force, a torque or another vector of the scene in RAS, shape (3,)."""
        return np.asarray(self._turn @ np.asarray(vector, dtype=np.float64))

    def pose(self, tip_mm: ArrayLike, rotation: ArrayLike) -> Array:
        """From a tool's frame to RAS [mm], shape (4, 4), by tip [mm] and orientation, shape (3,
        3), in the scene.
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self._turn @ np.asarray(rotation, dtype=np.float64)
        matrix[:3, 3] = self.points(np.reshape(tip_mm, (1, 3)))[0]
        return matrix

    def pose_in_scene(self, matrix: ArrayLike) -> tuple[Array, Array]:
        """Tip [mm] and orientation, shape (3, 3), in the scene of a tool with a pose in RAS
        [mm], shape (4, 4).
        """
        given = np.asarray(matrix, dtype=np.float64)
        return self._turn.T @ (given[:3, 3] - self._origin), self._turn.T @ given[:3, :3]
