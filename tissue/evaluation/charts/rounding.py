"""Error of computing in float32: how far a force moves when its path is moved by a last place."""

import numpy as np

from tissue.evaluation.charts.measure import reference_force_N
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Tool

__all__ = ["LAST_PLACE_MM", "float32_error"]

LAST_PLACE_MM = float(np.spacing(np.float32(10.0)))
"""Last place of a float32 at 10 mm, the size of a path: 1 nm."""


def float32_error(scene: Scene) -> float:
    """Change of the force of a cut, over the force, by a path moved aside by the last place of a float32 there.

    Voxels are cut in float32: all coordinates are rounded to about that, otherwise on the moved path. Where a tool only
    grazes voxels, rounding decides whether it touches, and this is much more than the last place of a force. NaN where
    a model computes in float64: organs, needles and walls.
    """
    motion = scene.motion
    if not isinstance(scene.tool, Tool) or not isinstance(motion, PathMotion):
        return float("nan")
    path = tuple((x + LAST_PLACE_MM, y - LAST_PLACE_MM, z - LAST_PLACE_MM) for x, y, z in motion.points_mm)
    shifted = scene.model_copy(update={"motion": motion.model_copy(update={"points_mm": path})})
    return force_error(reference_force_N(shifted, {"stress": None}), reference_force_N(scene, {"stress": None}))
