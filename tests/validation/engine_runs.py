"""Runs of the engine in the published set-ups."""

from functools import cache

import numpy as np
from published import DataSet, Row

import tissue

__all__ = ["DrillRun", "drill_run", "drill_scene", "reamed_error_mm"]

POINT_ANGLE_DEG = 118.0
BELOW_MM = 1.0
"""Depth of the steady part of a hole, from full engagement of the point on."""
DrillRun = tuple[float, float, float]


def drill_scene(data: DataSet, row: Row) -> tuple["tissue.Scene", float]:
    """Return the scene of a row's hole in a block, and the depth of full engagement [mm]."""
    assert data.diameter_mm is not None
    diameter = data.diameter_mm
    point = 0.5 * diameter / np.tan(np.radians(0.5 * POINT_ANGLE_DEG))
    depth = point + BELOW_MM
    feed_mm_min = data.unknown["feed_mm_min"].value if row.feed_mm_min is None else row.feed_mm_min
    scene = tissue.load_scene(
        "milling",
        {
            "anatomy.size_mm": [diameter + 2.0, diameter + 2.0, depth + 1.0],
            "anatomy.density_kg_m3": data.unknown["density_kg_m3"].value,
            "voxels.spacing_mm": 0.1,
            "tool.kind": "twist-drill",
            "tool.diameter_mm": diameter,
            "tool.length_mm": 20.0,
            "tool.flutes": 2,
            "tool.spin_rpm": row.rpm,
            "tool.shell_spacing_mm": None,
            "motion.points_mm": [[0.0, 0.0, 0.05], [0.0, 0.0, -depth]],
            "motion.feed_mm_s": feed_mm_min / 60.0,
            "duration_s": (depth + 0.05) / (feed_mm_min / 60.0),
        },
    )
    return scene, float(point)


def drill_run(data: DataSet, row: Row) -> DrillRun:
    """Return mean thrust [N] and torque [N mm] at full engagement, and the thrust's spread.

    The spread is the largest difference from the mean over the steady part, relative to the mean.
    """
    scene, point = drill_scene(data, row)
    trace = tissue.simulate(scene, progress=False).trace
    height = trace["tool_z_mm"]
    steady = (height < -point - 0.1) & (height > -point - BELOW_MM + 0.05)
    thrust = trace["model_force_z_N"][steady]
    torque = np.abs(trace["model_torque_z_Nm"][steady])
    spread = np.abs(thrust / thrust.mean() - 1.0).max()
    return float(thrust.mean()), float(1e3 * torque.mean()), float(spread)


@cache
def reamed_error_mm(law: str) -> float:
    """Return the error of a cavity that a hemispherical reamer leaves in voxels [mm].

    ``reamed diameter``: diameter of the best sphere minus that of the reamer, 61 mm. ``reamed
    sphere``: median distance of the surface from a sphere of 40 mm radius.
    """
    diameter = 61.0 if law == "reamed diameter" else 80.0
    depth = 6.0 if law == "reamed diameter" else 3.0
    cap = 2.0 * np.sqrt(depth * (diameter - depth))
    bone = tissue.Bone.block((cap + 6.0, cap + 6.0, depth + 3.0), spacing_mm=0.5)
    reamer = tissue.cutters.hemispherical_reamer(diameter_mm=diameter, flutes=16, spin_rpm=300.0)
    bone.cut(reamer, *tissue.feed_along([[0, 0, 1], [0, 0, -depth]], feed_mm_s=5.0))
    points = np.asarray(bone.surface().points)
    centre = np.array([0.0, 0.0, 0.5 * diameter - depth])
    reach = np.hypot(points[:, 0], points[:, 1])
    cavity = points[(reach < 0.5 * cap - 1.5) & (points[:, 2] < -0.3)]
    cavity = cavity[cavity[:, 2] > -depth - 1.0]
    distance = np.linalg.norm(cavity - centre, axis=1)
    if law == "reamed sphere":
        return float(np.median(np.abs(distance - 0.5 * diameter)))
    fitted = np.linalg.lstsq(
        np.column_stack([2.0 * cavity, np.ones(len(cavity))]), (cavity**2).sum(axis=1), rcond=None
    )[0]
    return float(2.0 * np.sqrt(fitted[3] + fitted[:3] @ fitted[:3]) - diameter)
