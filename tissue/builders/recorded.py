"""Find the file of recorded poses that move a tool."""

from pathlib import Path

from meshes.base.errors import is_file
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion

__all__ = ["plays_record", "recorded_file"]

RECORDED = "recorded"
"""Device whose motion is known from its file."""


def plays_record(scene: Scene) -> bool:
    """Return whether a device plays recorded poses from a file that exists.

    A saved run can be viewed without the file; its scene then has the motion of the scene.
    """
    return scene.device is not None and scene.device.kind == RECORDED and is_file(Path(scene.held.hardware.address))


def recorded_file(scene: Scene) -> str:
    """Return the file of the poses that move the tool, by a replay or a recorded device; empty for other motions."""
    if plays_record(scene):
        return scene.held.hardware.address
    return scene.motion.file if isinstance(scene.motion, ReplayMotion) else ""
