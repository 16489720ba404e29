"""Where a tool can go, and whether it meets the bone on its path."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.shapes.polyline import arc_length, points_along
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.motion.motion import Motion

__all__ = ["box_text", "reach", "require_outside", "require_touch"]

POSES_TRIED = 300
"""Poses along a motion at which contact is looked for."""
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]


def reach(cutter: Cutter, motion: Motion, margin: float) -> Corners:
    """Box around all that the cutting surface can reach, and a margin [m]."""
    shell = cutter.shell(spacing_m=cutter.profile.radius_m / 8.0).points_m
    tips, rotations = motion.sweep_m(), motion.rotations()
    starts = np.arange(0, len(tips), max(len(tips) // 500, 1))
    turned = [shell @ turn.T for turn in rotations[starts]]
    low = np.minimum.reduceat(tips, starts) + [points.min(axis=0) for points in turned]
    high = np.maximum.reduceat(tips, starts) + [points.max(axis=0) for points in turned]
    return low.min(axis=0) - margin, high.max(axis=0) + margin


def require_touch(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that never brings the cutting surface into bone."""
    shell = cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m
    corners, rotations = motion.sweep_m(), motion.rotations()
    along = arc_length(corners)
    between, corners_on = np.linspace(0.0, along[-1], POSES_TRIED), along[:: len(along) // POSES_TRIED + 1]
    wanted = np.unique(np.concatenate([between, corners_on]))
    tips = points_along(corners, wanted)
    turns = rotations[np.searchsorted(along, wanted)]
    limits = np.array(volume.shape)
    for tip, turn in zip(tips[::-1], turns[::-1], strict=True):
        at = np.floor((tip + shell @ turn.T - volume.origin_m) / volume.spacing_m).astype(int)
        at = at[((at >= 0) & (at < limits)).all(axis=1)]
        if volume.fraction[at[:, 0], at[:, 1], at[:, 2]].any():
            return
    raise InputError(
        "motion must bring the tool to the bone, got a tool that never touches it: move it to the bone "
        f"{box_text(volume.bounds_m, between=True)}"
    )


def require_outside(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that starts with the cutting surface inside the tooth."""
    shell = cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m
    points = motion.sweep_m()[0] + shell @ motion.rotations()[0].T
    at = np.floor((points - volume.origin_m) / volume.spacing_m).astype(int)
    at = at[((at >= 0) & (at < np.array(volume.shape))).all(axis=1)]
    inside = int((volume.fraction[at[:, 0], at[:, 1], at[:, 2]] == 255).sum())
    if inside:
        start = ", ".join(f"{1e3 * value:.4g}" for value in motion.sweep_m()[0])
        raise InputError(
            f"motion must start outside the tooth, got a bur at ({start}) mm with {inside / len(points):.0%} of its "
            "surface inside: start higher"
        )


def box_text(corners: Corners, *, between: bool = False) -> str:
    """A box in words: where it reaches from and to, or what lies between its corners [mm]."""
    low, high = ("(" + ", ".join(f"{1e3 * value:.4g}" for value in corner) + ")" for corner in corners)
    return f"between {low} and {high} mm" if between else f"{low} to {high} mm"
