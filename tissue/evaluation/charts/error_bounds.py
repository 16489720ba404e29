"""Errors that no setting goes below: their rows of a table, and that of float32, by a path moved by a last place."""

from math import nan

import numpy as np

from tissue.evaluation.charts.keys import machine
from tissue.evaluation.charts.measure import Measured
from tissue.evaluation.charts.reference import grid_force_N
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Tool

__all__ = ["BOUND_FAMILIES", "bound_row", "float32_error"]

BOUND_FAMILIES = ("law", "rounding")
"""Families of rows that are no settings. The error of a law is held to the neo-Hookean force, not to the reference."""
LAST_PLACE_MM = float(np.spacing(np.float32(10.0)))
"""Last place of a float32 at 10 mm, the size of a path: 1 nm."""


def bound_row(
    scene: Scene, name: str, family: str, error: float, *, leaves_out: str = "", median_us: float = nan,
    p99_us: float = nan, missed: int = 0, elements: int = 0, built_s: float = nan,
) -> Measured:  # fmt: skip
    """A row that is no setting; NaN for what it does not have, no tick for what only bounds an error."""
    return Measured(
        key="", scene=scene.name, setting=name, family=family, leaves_out=leaves_out, force_error=error,
        error_50_ms=nan, median_us=median_us, p99_us=p99_us, missed=missed, far_us=nan, engaged_mm2=nan,
        elements=elements, step_mm=nan, met=nan, built_s=built_s, machine=machine(),
    )  # fmt: skip


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
    return force_error(grid_force_N(shifted, {"stress": None}), grid_force_N(scene, {"stress": None}))
