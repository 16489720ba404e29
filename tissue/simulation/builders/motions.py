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
"""Device whose motion is known from its file."""


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
    """Return the file of the poses that move the tool, by a replay or a recorded device; empty
    for other motions.
    """
    if plays_record(scene):
        return scene.held.hardware.address
    return scene.motion.file if isinstance(scene.motion, ReplayMotion) else ""


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """Return the motion that a scene describes; with a recorded device the motion of its record.

    So the tool starts where it was recorded, and the tissue is made ready along the record.
    """
    if plays_record(scene):
        with names_of_caller({"motion.file": "hardware.address"}):
            return read_replay(Path(scene.held.hardware.address), step_s=step_s)
    make = MOTIONS[scene.motion.kind].make or MAKERS[scene.motion.kind]
    return make(scene.motion, step_s)


def path(motion: PathMotion, step_s: float) -> FollowPath:
    """Straight lines at a given feed."""
    return FollowPath(
        np.array(motion.points_mm) * 1e-3, feed_m_s=motion.feed_mm_s * 1e-3, axis=motion.axis
    )


def thrust(motion: ThrustMotion, step_s: float) -> PushAlongAxis:
    """A push down the axis."""
    return PushAlongAxis(
        np.array(motion.start_mm) * 1e-3,
        axis=motion.axis,
        thrust_N=motion.thrust_N,
        mass_kg=motion.mass_kg,
        max_feed_m_s=motion.max_feed_mm_s * 1e-3,
        depth_m=motion.depth_mm * 1e-3,
    )


def replay(motion: ReplayMotion, step_s: float) -> ReplayPoses:
    """Recorded poses."""
    return read_replay(Path(motion.file), step_s=step_s)


MAKERS: dict[str, Callable[[Any, float], Motion]] = {
    "path": path,
    "thrust": thrust,
    "replay": replay,
}
"""What makes the built-in motions."""
