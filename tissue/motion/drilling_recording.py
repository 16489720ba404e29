"""HDF5 recordings of volumetric_drilling, the mastoidectomy simulator of Johns Hopkins."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from meshes.base.extras import install_command
from meshes.base.file_limits import require_memory, require_regular
from tissue.motion.motion import first_off_unit

POSES = "physics_data/continuous_data/high_frequency_poses"
"""HDF5 group that contains one group of poses for each object."""
EVENTS = "physics_data/intermittent_data"
"""HDF5 group of intermittent events: removed voxels, burr changes and forces."""
OLD_POSES = "high_frequency_poses"
OLDEST_POSES = "data"
"""HDF5 group with the poses in recordings made from 2022 to 2025.

The group contains ``time``, which is common to all objects, and ``pose_OBJECT`` for each object. In
another older layout, the name of the group is `OLD_POSES`. In both older layouts, the groups of
events are at the root of the file.
"""
RECORDINGS = (".hdf5", ".h5")
"""File name suffixes of HDF5 recordings."""
SHAFT_TO_X = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])
"""Rotation from the tool frame of this package to the recorded drill frame.

The axis from tip to shank is z in the frame of this package, and x in the recorded frame.
"""


@dataclass(frozen=True, eq=False)
class DrillingRecording:
    """Content of a recording, converted to the tool frame of this package.

    The time of the first pose is 0.

    Attributes
    ----------
    times_s
        Increasing times of the poses [s], shape (n,). The first time is 0.
    tips_m
        Positions of the tip in the world frame of the recording [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4). The tool's z axis runs from tip to shank.
    load_times_s
        Times of the loads relative to the first pose [s], shape (m,). None if no loads were
        recorded.
    loads
        Forces on the tool in the world frame [N], shape (m, 3). If torques [N m] are known, they
        follow the forces, and the shape is (m, 6). Recorded torques are omitted if they are a copy
        of the forces.
    notes
        Findings about the file, and assumptions made; one sentence each.
    """

    times_s: Array
    tips_m: Array
    quaternions: Array
    load_times_s: Array | None
    loads: Array | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class PoseFile:
    """File of poses; its methods build errors that name the file.

    Attributes
    ----------
    path
        Path of the file.
    argument
        Name of the file in error messages, such as ``motion.file``.
    """

    path: Path
    argument: str

    def error(self, requirement: str, got: object, remedy: str) -> InputError:
        """Return the error for a value in the file."""
        return InputError(self.argument, requirement, f"{got} in {self.path}", remedy)

    def require_unit(self, quaternions: Array) -> None:
        """Check that quaternions (x, y, z, w), shape (n, 4), have unit length."""
        if (wrong := first_off_unit(quaternions)) is not None:
            length = float(np.linalg.norm(quaternions[wrong]))
            raise self.error(
                "contain unit quaternions",
                f"one of length {length:.4g} for pose {wrong + 1}",
                "use 0, 0, 0, 1 for no rotation",
            )


def read_drilling(path: Path, *, argument: str) -> DrillingRecording:
    """Read a recording of volumetric_drilling in the present or the older layout.

    The recorded pose is at the centre of the burr, with x towards the shank. If the file contains
    the burr's diameter, the recorded position is moved by half of it, to the tip. Otherwise the
    recorded position is used as the tip. The recorder sometimes stores a pose twice or out of
    order. Samples are therefore sorted by time. Of several samples with the same time, only the
    first is used. If the file contains exactly one camera, forces are rotated from the axes of the
    camera to the world frame.

    Parameters
    ----------
    path
        HDF5 file.
    argument
        Name of the file in error messages, such as ``motion.file``.

    Raises
    ------
    InputError
        If h5py is not installed, or the file is not a complete recording of this kind.
    """
    try:
        import h5py
    except ImportError:
        raise InputError(
            argument,
            "be readable with the installed packages",
            "a file that needs h5py",
            f"run {install_command('h5')}",
        ) from None
    require_regular(path)
    try:
        with h5py.File(path, "r") as file:
            return _drilling(file, PoseFile(path, argument))
    except (InputError, MemoryError):
        raise
    except Exception as problem:  # h5py raises many kinds of errors for a damaged file
        raise InputError(
            argument,
            "be a complete HDF5 file",
            f"{path} ({' '.join(str(problem).split())})",
            "export it again",
        ) from None


def poses_group(file: Any) -> str | None:
    """Return the name of the HDF5 group with the poses of the drill, or None without poses."""
    for group in (POSES, OLD_POSES):
        if group in file:
            return group
    # files of many programs have a group of this name
    if OLDEST_POSES in file and any("drill" in name for name in file[OLDEST_POSES]):
        return OLDEST_POSES
    return None


def _drilling(file: Any, where: PoseFile) -> DrillingRecording:
    """Return the content of an open recording."""
    poses = poses_group(file)
    events = EVENTS + "/" if poses == POSES else ""
    if poses is None:
        raise where.error(
            "be a recording of volumetric_drilling", f"no {POSES}", "give a CSV such as trace.csv"
        )
    names = list(file[poses])
    drills = [name for name in names if "drill" in name]
    if len(drills) != 1:
        raise where.error(
            "contain the poses of one object with drill in its name",
            enumerated(names) if names else "no object",
            "keep one such object",
        )
    notes = ["a recording of volumetric_drilling, in its world"]
    # Position and quaternion: 7 numbers. A wrench has 6: force and torque.
    times, pose = _samples(file, f"{poses}/{drills[0]}", "pose", 7, where)
    if len(times) < 2:
        raise where.error("contain at least two poses", len(times), "record more")
    where.require_unit(pose[:, 3:])
    turns = Rotation.from_quat(pose[:, 3:]) * SHAFT_TO_X
    tips = pose[:, :3]
    if f"{events}burr_change" in file:
        _, sizes = _samples(file, f"{events}burr_change", "burr_size", 1, where)
        if len(np.unique(sizes)) != 1 or sizes[0, 0] <= 0.0:
            raise where.error(
                "use one burr of positive size",
                f"sizes {sorted(set(sizes[:, 0].tolist()))} mm",
                "split the recording where the burr changes",
            )
        # From the centre of the burr to its tip: half the diameter, in metres.
        tips = tips - turns.apply([0.0, 0.0, 0.5e-3 * sizes[0, 0]])
    else:
        notes.append("no size of the burr: the recorded point of the drill counts as its tip")
    start = float(times[0])
    load_times = None
    loads = None
    if f"{events}drill_force_feedback" in file:
        load_times, loads = _samples(file, f"{events}drill_force_feedback", "wrench", 6, where)
        cameras = [name for name in names if "camera" in name]
        if len(cameras) == 1:
            # volumetric_drilling.cpp, commit 001d332: the plugin publishes R^T F, with the
            # orientation R of its main camera, as the force and again as the torque.
            shown, seen = _samples(file, f"{poses}/{cameras[0]}", "pose", 7, where)
            if len(shown) == 0:
                raise where.error(f"contain poses of {cameras[0]}", "none", "record it again")
            where.require_unit(seen[:, 3:])
            nearest = np.clip(np.searchsorted(shown, load_times), 0, len(shown) - 1)
            camera = Rotation.from_quat(seen[nearest, 3:])
            loads = np.hstack([camera.apply(loads[:, :3]), camera.apply(loads[:, 3:])])
            notes.append("forces turned from the camera's axes to the world's")
        if len(loads) and loads.any() and np.array_equal(loads[:, :3], loads[:, 3:]):
            loads = loads[:, :3]
            notes.append(
                "torques left out: they are a copy of the forces, as the recorded program "
                "sends them"
            )
        load_times = load_times - start
    return DrillingRecording(times - start, tips, turns.as_quat(), load_times, loads, tuple(notes))


def _samples(file: Any, group: str, name: str, width: int, where: PoseFile) -> tuple[Array, Array]:
    """Return the increasing times [s], shape (n,), and values, shape (n, width), of a data set."""
    import h5py

    found = []
    # in files of 2022 to 2025 a pose is a dataset, next to the common times
    is_bare = isinstance(file.get(group), h5py.Dataset)
    pair = (
        (f"{group.rpartition('/')[0]}/time", group)
        if is_bare
        else (f"{group}/time_stamp", f"{group}/{name}")
    )
    for each in pair:
        dataset = file.get(each)
        if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
            raise where.error(f"contain numbers in {each}", "none", "record it again")
        # The values become doubles of 8 bytes in memory, after they were read as stored.
        size = max(dataset.dtype.itemsize, 8) * dataset.size
        require_memory(size, where.path.name, f"{dataset.size:.3g} numbers as {each}")
        found.append(np.asarray(dataset[()], dtype=np.float64))
    times, values = found
    values = values[:, None] if values.ndim == 1 and width == 1 else values
    if times.ndim != 1 or values.shape != (len(times), width):
        raise where.error(
            f"contain {width} values of {group}/{name} at each time_stamp",
            f"shapes {values.shape} and {times.shape}",
            "record it again",
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise where.error(
            "contain only finite numbers", f"NaN or infinity for {group}", "remove these samples"
        )
    order = np.unique(times, return_index=True)[1]
    return times[order], values[order]
