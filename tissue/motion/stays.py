"""Motion that stays at its start, to define pose and region of a tool on a device."""

from math import inf

import numpy as np

from meshes.base.arrays import Array
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.motion import Motion, frame_along

__all__ = ["StaysAt"]


class StaysAt(Motion):
    """Motion of a tool at rest.

    Parameters
    ----------
    start_m
        Position of the tip [m].
    axis
        Direction from tip to shank.
    """

    duration_s = inf

    def __init__(self, start_m: Array, axis: tuple[float, float, float]) -> None:
        self._start = np.array(start_m, dtype=np.float64)
        self._rotation = frame_along(axis)

    def sweep_m(self) -> Array:
        """Return the only position [m]."""
        return self._start[None]

    def rotations(self) -> Array:
        """Return the only orientation."""
        return self._rotation[None]

    def begin(self, motion: ToolMotion) -> None:
        """Write the pose."""
        motion.tip_m[:] = self._start
        motion.rotation[:] = self._rotation

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Leave the tool at rest."""
