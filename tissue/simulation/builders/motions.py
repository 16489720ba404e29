"""Build the motion that a scene names."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import is_file, names_of_caller
from tissue.motion.motion import FollowPath, Motion
from tissue.motion.replay import ReplayPoses, read_replay
from tissue.motion.thrust import PushAlongAxis
from tissue.scene.registry import MOTIONS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion

__all__ = ["motion_of", "path", "plays_record", "recorded_file", "replay", "thrust"]

RECORDED = "recorded"
"""Device that plays a motion recorded in a file."""


def plays_record(scene: Scene) -> bool:
    """Return whether a device plays recorded poses from a file that exists.

    A saved run can be viewed without the file; its scene then has the motion of the scene.
    """
    return (
        scene.device is not None
        and scene.device.kind == RECORDED
        and is_file(Path(scene.held.hardware.address))
    )


def recorded_file(scene: Scene) -> str:
    """Return the file of the poses that move the tool; empty for other motions.

    The file comes from a replay or a recorded device.
    """
    if plays_record(scene):
        return scene.held.hardware.address
    return scene.motion.file if isinstance(scene.motion, ReplayMotion) else ""


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """Return the motion of a scene, or of the record with a recorded device.

    The tool then starts where it was recorded, and the tissue is prepared along the record.
    """
    if plays_record(scene):
        with names_of_caller({"motion.file": "hardware.address"}):
            return read_replay(Path(scene.held.hardware.address), step_s=step_s)
    make = MOTIONS[scene.motion.kind].make or MAKERS[scene.motion.kind]
    return make(scene.motion, step_s)


def path(motion: PathMotion, step_s: float) -> FollowPath:
    """Return a motion along straight lines at a given feed."""
    return FollowPath(
        np.array(motion.points_mm) * 1e-3, feed_m_s=motion.feed_mm_s * 1e-3, axis=motion.axis
    )


def thrust(motion: ThrustMotion, step_s: float) -> PushAlongAxis:
    """Return a push along the axis."""
    return PushAlongAxis(
        np.array(motion.start_mm) * 1e-3,
        axis=motion.axis,
        thrust_N=motion.thrust_N,
        mass_kg=motion.mass_kg,
        max_feed_m_s=motion.max_feed_mm_s * 1e-3,
        depth_m=motion.depth_mm * 1e-3,
    )


def replay(motion: ReplayMotion, step_s: float) -> ReplayPoses:
    """Return the motion of recorded poses."""
    return read_replay(Path(motion.file), step_s=step_s)


MAKERS: dict[str, Callable[[Any, float], Motion]] = {
    "path": path,
    "thrust": thrust,
    "replay": replay,
}
"""Functions that make the built-in motions."""
