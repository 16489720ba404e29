"""Build what a scene names: its motion and its tissue, by the tables of `tissue.scene.registry`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from tissue.builders.own_constants import note_own_constants
from tissue.builders.parts import Parts, TissueBuilder
from tissue.builders.recorded import plays_record
from tissue.motion.motion import FollowPath, Motion
from tissue.motion.replay import ReplayPoses, read_replay
from tissue.motion.thrust import PushAlongAxis
from tissue.scene.registry import ANATOMIES, MOTIONS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion

__all__ = ["build", "builder_of", "motion_of", "path", "replay", "thrust"]


def build(
    scene: Scene, *, step_s: float, compute: str, cores: int | None, report: Progress, allow_unstable: bool = False
) -> Parts:
    """Build the parts of a scene.

    Raises
    ------
    InputError
        If a file cannot be used, something would not fit memory, the tool never touches, there is no such device, or
        its coupling is unstable and that is not allowed.
    """
    _require_device(compute)
    motion = motion_of(scene, step_s=step_s)
    tissue = builder_of(scene.anatomy.kind)
    if scene.device is None:
        parts = tissue(scene, motion, step_s=step_s, compute=compute, cores=cores, report=report)
        note_own_constants(scene, parts.tissue.layer_names, parts.notes)
        return parts
    from tissue.builders.hand import hand_motion

    held, note = hand_motion(scene, motion, step_s=step_s, allow_unstable=allow_unstable)
    parts = tissue(scene, held, step_s=step_s, compute=compute, cores=cores, report=report)
    parts.notes["coupling"] = note
    note_own_constants(scene, parts.tissue.layer_names, parts.notes)
    return parts


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
    return FollowPath(np.array(motion.points_mm) * 1e-3, feed_m_s=motion.feed_mm_s * 1e-3, axis=motion.axis)


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


MAKERS: dict[str, Callable[[Any, float], Motion]] = {"path": path, "thrust": thrust, "replay": replay}
"""What makes the built-in motions."""


def builder_of(kind: str) -> TissueBuilder:
    """Return what builds the parts of a run in a tissue, by the kind of its anatomy."""
    from tissue.builders import cutting, organ_scene

    outside: TissueBuilder | None = ANATOMIES[kind].build
    if outside is not None:
        return outside
    others = {"slab": organ_scene.pressed, "liver": organ_scene.pressed, "layers": organ_scene.pierced}
    return (others | {"wall": organ_scene.wall}).get(kind, cutting.milled)


def _require_device(compute: str) -> None:
    """Refuse a device that is not there; the processor always is."""
    if compute == "cpu":
        return
    import warp as wp

    known = [str(device) for device in wp.get_devices()]
    if compute not in known:
        raise InputError(f"compute must be one of {', '.join(known)}, got {compute}: use cpu here")
