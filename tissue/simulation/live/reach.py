"""Where the pointer of a live run starts, and how far it may take the tool."""

import numpy as np
from numpy.typing import NDArray

from tissue.builders.motions import motion_of
from tissue.builders.parts import Parts
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool

__all__ = ["reach_m", "start_m"]

ABOVE_M, BELOW_M = 0.02, 0.01
"""How far the pointer may draw a tool back from the scripted path and press a probe beyond it [m]; a tool that cuts it
presses as far as there is bone beyond what the script reaches."""


def start_m(scene: Scene) -> tuple[float, float, float]:
    """Where the scripted motion starts [m]."""
    x, y, z = motion_of(scene, step_s=TICK_S).sweep_m()[0]
    return float(x), float(y), float(z)


def reach_m(scene: Scene, parts: Parts) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the box in which the pointer may move the tool [m]: around the scripted path, and back from it."""
    path = parts.motion.sweep_m()
    axis = parts.motion.rotations()[0][:, 2]
    below_m = 1e-3 * scene.voxels.margin_mm if isinstance(scene.tool, Tool) else BELOW_M
    points = np.concatenate([path + ABOVE_M * axis, path - below_m * axis])
    return points.min(axis=0), points.max(axis=0)
