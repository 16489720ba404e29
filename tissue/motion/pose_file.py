"""Files of cutter poses, which together with the uncut bone define a cavity."""

from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.file_limits import read_npz
from meshes.base.whole_file import whole_file
from meshes.voxels.volume import VoxelVolume

__all__ = ["COLUMNS", "poses_of_trace", "read_poses", "write_poses"]

COLUMNS = 13
"""Columns of a pose: tick, tip [m], axis, and rate of the pose over speed (linear, angular)."""
FORMAT = 1
"""Version of the file of poses."""


def write_poses(path: Path, poses: Array, volume: VoxelVolume) -> None:
    """Write poses, and origin and spacing of the voxels that they cut, to a .npz file."""
    with whole_file(path) as temporary, temporary.open("wb") as file:
        arrays = {
            "poses": poses,
            "origin_m": volume.origin_m,
            "spacing_m": np.array(volume.spacing_m),
        }
        np.savez_compressed(file, format=np.array(FORMAT), **arrays)  # type: ignore[arg-type]


def read_poses(path: Path) -> tuple[Array, Array, float]:
    """Read poses, the origin of the voxels [m], shape (3,), and their spacing [m].

    The file was written by `write_poses`.

    Raises
    ------
    InputError
        If the file is damaged or of another version.
    """
    try:
        held = read_npz(path)
        version = int(held["format"])
        poses = np.asarray(held["poses"], dtype=np.float64)
        origin = np.asarray(held["origin_m"], dtype=np.float64)
        spacing = float(held["spacing_m"])
        is_whole = (
            poses.shape[1:] == (COLUMNS,)
            and origin.shape == (3,)
            and np.isfinite([*poses.ravel(), *origin, spacing]).all()
            and (np.diff(poses[:, 0]) >= 0.0).all()
        )
    except InputError:
        raise
    except Exception:  # NumPy and zipfile raise a dozen kinds for a damaged archive
        is_whole = False
        version = FORMAT
    if version != FORMAT or not is_whole:
        raise InputError(
            "poses",
            f"be a whole file of format {FORMAT} that a run wrote",
            path,
            "run the scene again",
        )
    return poses, origin, spacing


def poses_of_trace(tips_m: Array, axes: Array, velocities: Array) -> Array:
    """Build the poses of a run from its trace, where the file of poses is missing.

    The shape of the bone is then accurate to the distance that a tool moves between two cuts.

    Parameters
    ----------
    tips_m, axes
        Tip [m] and axis of the tool at every tick, shape (n, 3).
    velocities
        Velocity of the tip [m/s] and angular velocity [rad/s], shape (n, 6).
    """
    speed = np.linalg.norm(velocities[:, :3], axis=1, keepdims=True)
    heading = np.divide(velocities, speed, out=np.zeros_like(velocities), where=speed > 0.0)
    poses = np.column_stack([np.arange(len(tips_m)), tips_m, axes, heading])
    return (
        np.vstack([np.append(-1.0, poses[0, 1:]), poses]) if len(poses) else np.zeros((0, COLUMNS))
    )
