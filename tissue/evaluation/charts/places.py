"""Where a tool lies on the grid or the mesh is an accident: the same motion at more than one place.

The error of a discretisation depends on it. A path that runs along voxels is cut better than one between them, and the
tetrahedra under a probe are split otherwise a millimetre aside; what was measured at one place alone holds there alone.
"""

import numpy as np

from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe, Tool

__all__ = ["PLACES", "moved", "placed"]

PLACES = ((0.0, 0.0, 1.0), (-0.37, -0.61, 1.07), (0.61, 0.37, 0.93))
"""Shifts along x and y, as shares of the coarsest step, and factors of the depth. No share of a half, third or
quarter, so that the tool lies elsewhere on the finer grids as well; less and more deep, since what a tool's depth makes
of a mesh is as much an accident."""
COARSEST = 4.0
"""Coarsest voxel of a chart over the scene's own."""


def placed(scene: Scene) -> list[Scene]:
    """The scene and the same with its path moved: three where a path leads a tool on a grid, else the scene alone."""
    if scene.device is not None or not isinstance(scene.motion, PathMotion):
        return [scene]
    if isinstance(scene.tool, Tool):
        # A peg in its hole leaves the tool no more than this.
        step = scene.voxels.spacing_mm * (0.5 if scene.tool.peg_mm[0] else COARSEST)
    elif isinstance(scene.anatomy, SoftAnatomy) and isinstance(scene.tool, Probe):
        step = scene.anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm
    else:
        return [scene]
    return [scene, *(moved(scene, x * step, y * step, depth=depth) for x, y, depth in PLACES[1:])]


def moved(scene: Scene, x_mm: float, y_mm: float, *, depth: float = 1.0) -> Scene:
    """The scene with its path moved aside, and what lies below the surface, z = 0, made deeper by a factor."""
    assert isinstance(scene.motion, PathMotion)
    points = np.array(scene.motion.points_mm)
    points[:, 2] = np.where(points[:, 2] < 0.0, depth * points[:, 2], points[:, 2])
    points[:, :2] += x_mm, y_mm
    path = tuple((x, y, z) for x, y, z in points.round(5).tolist())
    return scene.model_copy(update={"motion": scene.motion.model_copy(update={"points_mm": path})})
