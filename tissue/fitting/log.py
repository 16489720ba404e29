"""A measured log of poses and loads."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from tissue.builders.registry import motion_of
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene

__all__ = ["MeasuredLog"]


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """What was measured while a tool moved.

    Attributes
    ----------
    path
        File.
    times_s
        Increasing times of the poses [s], shape (n,).
    tips_m
        Tips of the tool in the scene's frame [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4); None of a log without.
    load_times_s
        Times of the loads [s], shape (m,).
    loads
        Loads on the tool in the scene's frame [N, N m], torques about the tip, shape (m, channels); NaN where missing.
    channels
        Their names, such as ``force_x_N``.
    notes
        What was found or assumed, in sentences.
    """

    path: Path
    times_s: Array
    tips_m: Array
    quaternions: Array | None
    load_times_s: Array
    loads: Array
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def quaternions_of(self, scene: Scene) -> Array:
        """Orientations, those at the start of the scene's motion where the log has none, shape (n, 4)."""
        if self.quaternions is not None:
            return self.quaternions
        first = motion_of(scene, step_s=TICK_S).rotations()[0]
        return np.tile(Rotation.from_matrix(first).as_quat(), (len(self.times_s), 1))
