"""Motion of a tool through poses in bone, with warnings outside the valid range."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.cutters.cutter import Cutter
from tissue.models.bone.model import BoneModel
from tissue.models.keep_clear import KeepClear
from tissue.motion.replay import GivenPoses
from tissue.objects.cut import Cut
from tissue.scene.scene import Output
from tissue.simulation.builders.bone import VoxelBone, tool_boxes
from tissue.simulation.builders.parts import Parts
from tissue.simulation.loop import Loop, undisturbed

__all__ = ["TimedPoses", "cut_along", "require_cutter", "warn_of"]


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """Poses of a tool: times [s], shape (n,), tips [m], shape (n, 3), and rotations."""

    times_s: Array
    tips_m: Array
    rotations: Rotation


def cut_along(
    bone: VoxelBone,
    tool: Cutter,
    poses: TimedPoses,
    *,
    shell_spacing_m: float,
    keep_clear: KeepClear | None,
) -> Cut:
    """Cut along poses; see `tissue.objects.bone.Bone.cut`."""
    tips = poses.tips_m
    turns = poses.rotations
    motion = GivenPoses(poses.times_s, tips, turns)
    boxes = tool_boxes(tool, tips, turns.as_matrix()[:, :, 2], spacing_m=bone.store.grid.spacing_m)
    model, goes_on = bone.under(
        tool, boxes, (tips[0], turns[0].as_matrix()), shell_spacing_m=shell_spacing_m
    )
    before = model.removed_m3
    parts = Parts(motion, model, cutter=tool, keep_clear=keep_clear)
    loop = Loop(parts, ticks=len(tips), output=Output(low_pass_ms=0.0))
    model.limits.restart()
    bone.left_at = None
    loop.place(resume=goes_on)
    with undisturbed():
        for number in range(len(tips)):
            loop.step()
            _require_chips(model, number)
    loop.finish()
    loop.close()
    bone.left_at = tips[-1], turns[-1].as_matrix()
    cut = Cut.of(loop, poses.times_s, removed_before_m3=before)
    cut.notes |= model.limits.passed
    warn_of(list(model.limits.passed.values()))
    return cut


def warn_of(sentences: Sequence[str]) -> None:
    """Issue a Python warning for each sentence."""
    for sentence in sentences:
        warnings.warn(sentence, stacklevel=4)


def require_cutter(tool: object, *, spacing_mm: float) -> None:
    """Refuse a tool that cannot cut bone with voxels of this size [mm]."""
    if not isinstance(tool, Cutter):
        raise InputError(
            "tool", "be a cutter", type(tool).__name__, "make one by tissue.cutters.ball_burr"
        )
    width_mm = 2e3 * tool.profile.radius_m
    if width_mm < 4.0 * spacing_mm:
        raise InputError(
            "tool",
            f"be at least four voxels of {spacing_mm:g} mm wide",
            f"{width_mm:.3g} mm",
            f"give the bone spacing_mm = {width_mm / 20:.2g}",
        )


def _require_chips(model: BoneModel, number: int) -> None:
    """Refuse a chip that is thicker than the tool's radius."""
    thickest_mm = 1e3 * model.limits.thickest_m
    radius_mm = 1e3 * model.cutter.profile.radius_m
    if thickest_mm > radius_mm:
        raise InputError(
            "times_s",
            f"leave a tooth chips thinner than the tool's radius of {radius_mm:.3g} mm",
            f"{thickest_mm:.3g} mm at pose {number}, up to which the bone is cut",
            "use a slower feed or a higher speed of the tool",
        )
