"""Build what a scene names: its motion, and its tissue by the table of anatomies."""

from math import pi
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.builders.parts import Parts
from tissue.cutters.cutter import Cutter
from tissue.models.wall import WallModel
from tissue.motion.motion import FollowPath, Motion, PushAlongAxis
from tissue.motion.replay import read_poses
from tissue.scene.coupling import WallAnatomy
from tissue.scene.named_parts import loaded
from tissue.scene.registry import ANATOMIES, CUTTERS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe, ReplayMotion, ThrustMotion, Tool

__all__ = ["build", "cutter_of", "milled", "motion_of", "pierced", "pressed", "wall"]


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
    tissue = loaded(ANATOMIES[scene.anatomy.kind].build)
    if scene.device == "none":
        return tissue(scene, motion, step_s=step_s, compute=compute, cores=cores, report=report)
    from tissue.builders.hand import hand_motion

    held, note = hand_motion(scene, motion, step_s=step_s, allow_unstable=allow_unstable)
    parts = tissue(scene, held, step_s=step_s, compute=compute, cores=cores, report=report)
    parts.notes["coupling"] = note
    return parts


def milled(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a cutter mills bone or a tooth."""
    from tissue.builders.cutting import cut

    assert isinstance(scene.tool, Tool)
    return cut(scene, cutter_of(scene.tool), motion, compute=compute, cores=cores, report=report)


def pressed(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a probe presses an organ."""
    from tissue.builders.organ_scene import press

    return press(scene, motion, step_s=step_s, compute=compute, cores=cores, report=report)


def pierced(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a needle pierces layers."""
    from tissue.builders.organ_scene import pierce

    return pierce(scene, motion, report=report)


def wall(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a ball is pushed against a wall."""
    assert isinstance(scene.anatomy, WallAnatomy) and isinstance(scene.tool, Probe)
    radius_m = 0.5e-3 * scene.tool.diameter_mm
    return Parts(motion, WallModel(1e3 * scene.anatomy.stiffness_kN_m, radius_m=radius_m))


def cutter_of(tool: Tool) -> Cutter:
    """The cutter that a scene's tool describes."""
    profile = loaded(CUTTERS[tool.kind].profile)(tool)
    return Cutter(profile, tool.flutes, tool.spin_rpm * 2.0 * pi / 60.0)


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """The motion that a scene describes."""
    match scene.motion:
        case PathMotion() as path:
            return FollowPath(np.array(path.points_mm) * 1e-3, feed_m_s=path.feed_mm_s * 1e-3, axis=path.axis)
        case ThrustMotion() as push:
            return PushAlongAxis(
                np.array(push.start_mm) * 1e-3,
                axis=push.axis,
                thrust_N=push.thrust_N,
                mass_kg=push.mass_kg,
                max_feed_m_s=push.max_feed_mm_s * 1e-3,
                depth_m=push.depth_mm * 1e-3,
            )
        case ReplayMotion() as replay:
            return read_poses(Path(replay.file), step_s=step_s)


def _require_device(compute: str) -> None:
    """Refuse a device that is not there; the processor always is."""
    if compute == "cpu":
        return
    import warp as wp

    known = [str(device) for device in wp.get_devices()]
    if compute not in known:
        raise InputError(f"compute must be one of {', '.join(known)}, got {compute}: use cpu here")
