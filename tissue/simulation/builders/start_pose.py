"""Check the first pose of a recorded motion for quaternions in another order."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.motion.motion import Motion
from tissue.motion.replay import RECORDINGS, SHAFT_TO_X

__all__ = ["w_first_notice"]

MUCH_MORE = 2.0
"""Ratio of the volumes inside the bone above which the other quaternion order is suggested."""


def w_first_notice(volume: VoxelVolume, cutter: Cutter, motion: Motion, file: str) -> str | None:
    """Return a sentence if the start pose suggests that w is the first column; else None.

    The tool then starts inside the bone, and would hardly do so with the other order.

    A quaternion has unit length in either order, so only the position of the tool shows the order.

    Parameters
    ----------
    volume
        The bone.
    cutter
        The tool.
    motion
        The recorded motion.
    file
        File of the recorded poses, whose kind gives the axis of the recorded tool.
    """
    turn = SHAFT_TO_X if Path(file).suffix.lower() in RECORDINGS else Rotation.identity()
    rotation = Rotation.from_matrix(motion.rotations()[0])
    first, second, third, fourth = (rotation * turn.inv()).as_quat()
    other = Rotation.from_quat([second, third, fourth, first]) * turn
    tip_m = motion.sweep_m()[0]
    inside = _inside_mm3(volume, cutter, tip_m, rotation)
    by_other = _inside_mm3(volume, cutter, tip_m, other)
    if inside <= MUCH_MORE * by_other:
        return None
    return (
        f"the tool starts with {inside:.3g} mm3 inside the bone. With its quaternions read "
        "as (w, x, y, z) it would be "
        f"{by_other:.3g} mm3: their order is (x, y, z, w), so swap the columns of {file} if "
        "w comes first"
    )


def _inside_mm3(volume: VoxelVolume, cutter: Cutter, tip_m: Array, rotation: Rotation) -> float:
    """Return the bone inside the cutter at a pose [mm3], by the centres of the voxels."""
    spacing_m = volume.spacing_m
    low_m, high_m = cutter.profile.height_range_m
    radius_m = cutter.profile.radius_m
    sides_m = (-radius_m, radius_m)
    corners_m = np.array([[x, y, z] for x in sides_m for y in sides_m for z in (low_m, high_m)])
    box = (rotation.apply(corners_m) + tip_m - volume.origin_m) / spacing_m
    first = np.clip(np.floor(box.min(axis=0)).astype(int), 0, volume.shape)
    last = np.clip(np.ceil(box.max(axis=0)).astype(int), 0, volume.shape)
    held = volume.fraction[tuple(slice(start, end) for start, end in zip(first, last, strict=True))]
    filled = np.argwhere(held)
    if not len(filled):
        return 0.0
    centres_m = volume.origin_m + spacing_m * (first + filled + 0.5)
    x, y, z = rotation.inv().apply(centres_m - tip_m).T
    distance_m, _ = cutter.profile.distance(np.column_stack([np.hypot(x, y), z]))
    shares = held[tuple(filled.T)] / FULL
    return float(1e9 * spacing_m**3 * shares[distance_m < 0.0].sum())
