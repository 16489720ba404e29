"""Recorded motion: replay of a table of poses or of a recording of volumetric_drilling."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from meshes.base.arrays import Array
from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.base.extras import install_command
from meshes.base.file_limits import read_npz, require_memory, require_regular
from meshes.base.tables import read_table
from meshes.base.text_tables import require_distinct_columns
from meshes.base.units import UNITS, column_of, unit_of
from meshes.base.whole_file import whole_file
from meshes.paths.toolpath import POSE_COLUMNS
from meshes.voxels.volume import VoxelVolume
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.motion import LONGEST_S, Motion, first_off_unit

__all__ = [
    "COLUMNS",
    "EVENTS",
    "POSES",
    "SHAFT_TO_X",
    "DrillingRecording",
    "GivenPoses",
    "ReplayPoses",
    "poses_group",
    "poses_of_trace",
    "read_drilling",
    "read_poses",
    "read_replay",
    "write_poses",
]


POSES = "physics_data/continuous_data/high_frequency_poses"
"""HDF5 group that contains one group of poses for each object."""
EVENTS = "physics_data/intermittent_data"
"""HDF5 group of intermittent events: removed voxels, burr changes and forces."""
OLD_POSES = "high_frequency_poses"
OLDEST_POSES = "data"
"""Groups of the poses in files of older layouts, whose event groups lie at the root.

Recordings of 2022 to 2025 have ``data/time`` and ``data/pose_OBJECT``, one clock for all objects.
"""
SHAFT_TO_X = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])
"""Rotation from our tool frame to the recorded drill frame.

The axis from tip to shank is z in our frame and x in the recorded frame.
"""


@dataclass(frozen=True, eq=False)
class DrillingRecording:
    """Content of a recording, in our tool's frame and with times that start at the first pose.

    Attributes
    ----------
    times_s
        Increasing times of the poses [s] from 0, shape (n,).
    tips_m
        Tips of the tool in the recording's world [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), the tool's z axis from tip to shank, shape (n, 4).
    load_times_s
        Times of the loads on the clock of the poses [s], shape (m,); None without recorded loads.
    loads
        Forces on the tool in the world [N], shape (m, 3). With torques [N m] that are not a copy of
        the forces, shape (m, 6).
    notes
        Findings and assumptions, one sentence each.
    """

    times_s: Array
    tips_m: Array
    quaternions: Array
    load_times_s: Array | None
    loads: Array | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _File:
    """File and its name in errors."""

    path: Path
    what: str

    def error(self, requirement: str, got: object, remedy: str) -> InputError:
        return InputError(self.what, requirement, f"{got} in {self.path}", remedy)

    def require_unit(self, quaternions: Array) -> None:
        """Check the length of quaternions (x, y, z, w), shape (n, 4)."""
        if (wrong := first_off_unit(quaternions)) is not None:
            length = float(np.linalg.norm(quaternions[wrong]))
            raise self.error(
                "hold unit quaternions",
                f"one of length {length:.4g} for pose {wrong + 1}",
                "use 0, 0, 0, 1 for no rotation",
            )


def read_drilling(path: Path, *, what: str) -> DrillingRecording:
    """Read a recording of volumetric_drilling in the present or the older layout.

    The recorded pose is at the centre of the burr, with x towards the shank. It is moved to the tip
    by half the burr size if the file contains the size. Otherwise the recorded point is used as the
    tip. The recorder sometimes receives a pose twice or out of order. Samples are therefore sorted,
    and the first sample of each time is kept. If the file contains one camera, forces are rotated
    from its axes back into the world.

    Parameters
    ----------
    path
        HDF5 file.
    what
        Name of the file in errors, such as ``motion.file``.

    Raises
    ------
    InputError
        If h5py is not installed, or the file is not a complete recording of this kind.
    """
    try:
        import h5py
    except ImportError:
        raise InputError(
            what, "have what reads it installed", "no h5py", install_command("h5")
        ) from None
    require_regular(path)
    try:
        with h5py.File(path, "r") as file:
            return _drilling(file, _File(path, what))
    except (InputError, MemoryError):
        raise
    except Exception as problem:  # h5py raises a dozen kinds for a damaged file
        raise InputError(
            what,
            "be a whole HDF5 file",
            f"{path} ({' '.join(str(problem).split())})",
            "export it again",
        ) from None


def poses_group(file: Any) -> str | None:
    """Return the group of the poses of a drill in an HDF5 file, None in any other file."""
    for group in (POSES, OLD_POSES):
        if group in file:
            return group
    # many programs have a group of this name
    if OLDEST_POSES in file and any("drill" in name for name in file[OLDEST_POSES]):
        return OLDEST_POSES
    return None


def _drilling(file: Any, where: _File) -> DrillingRecording:
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
            "hold the poses of one drill", ", ".join(names) or "no object", "leave one with drill"
        )
    notes = ["a recording of volumetric_drilling, in its world"]
    # Position and quaternion: 7 numbers. A wrench has 6: force and torque.
    times, pose = _samples(file, f"{poses}/{drills[0]}", "pose", 7, where)
    if len(times) < 2:
        raise where.error("hold at least two poses", len(times), "record more")
    where.require_unit(pose[:, 3:])
    turns = Rotation.from_quat(pose[:, 3:]) * SHAFT_TO_X
    tips = pose[:, :3]
    if f"{events}burr_change" in file:
        _, sizes = _samples(file, f"{events}burr_change", "burr_size", 1, where)
        if len(np.unique(sizes)) != 1 or sizes[0, 0] <= 0.0:
            raise where.error(
                "keep one burr",
                f"sizes {sorted(set(sizes[:, 0].tolist()))} mm",
                "cut it where it changes",
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
                raise where.error("hold poses", f"none for {cameras[0]}", "record it again")
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


def _samples(file: Any, group: str, name: str, width: int, where: _File) -> tuple[Array, Array]:
    """Return increasing times [s], shape (n,), and the values at these times, shape (n, width)."""
    import h5py

    found = []
    # a pose of 2022 to 2025 is a dataset next to the times of all poses
    is_bare = isinstance(file.get(group), h5py.Dataset)
    pair = (
        (f"{group.rpartition('/')[0]}/time", group)
        if is_bare
        else (f"{group}/time_stamp", f"{group}/{name}")
    )
    for each in pair:
        dataset = file.get(each)
        if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
            raise where.error(f"hold numbers as {each}", "none", "record it again")
        # In memory as doubles, 8 bytes each, but first as stored.
        size = max(dataset.dtype.itemsize, 8) * dataset.size
        require_memory(size, where.path.name, f"{dataset.size:.3g} numbers as {each}")
        found.append(np.asarray(dataset[()], dtype=np.float64))
    times, values = found
    values = values[:, None] if values.ndim == 1 and width == 1 else values
    if times.ndim != 1 or values.shape != (len(times), width):
        raise where.error(
            f"hold {width} values of {group}/{name} at each time_stamp",
            f"shapes {values.shape} and {times.shape}",
            "record it again",
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise where.error("hold finite numbers", f"others for {group}", "cut them out")
    order = np.unique(times, return_index=True)[1]
    return times[order], values[order]


RECORDINGS = (".hdf5", ".h5")
"""File name suffixes of HDF5 recordings."""


FARTHEST_M = 10.0
"""Largest distance between two poses along an axis [m].

Tools in a patient move by less than a metre.
"""


class GivenPoses(Motion):
    """Motion through given poses, one per tick.

    The velocity at a pose is its difference to the previous pose over the tick length.

    Parameters
    ----------
    times_s
        Increasing times [s], shape (n,).
    tips_m
        Tip positions [m], shape (n, 3).
    turns
        Orientations, n of them.

    Raises
    ------
    InputError
        If two positions lie further apart than `FARTHEST_M`.
    """

    def __init__(self, times_s: Array, tips_m: Array, turns: Rotation) -> None:
        extent_m = float(np.ptp(tips_m, axis=0).max())
        if extent_m > FARTHEST_M:
            # The carving visits the whole swept region, which one damaged number would make
            # endless.
            raise InputError(
                "poses",
                f"lie within {FARTHEST_M:g} m of each other",
                f"{extent_m:.3g} m",
                "leave damaged rows out, and check the unit of the positions",
            )
        self.duration_s = float(times_s[-1] - times_s[0])
        self._tips = tips_m
        self._rotations = turns.as_matrix()
        steps = np.diff(times_s)[:, None]
        moved = np.diff(tips_m, axis=0) / steps
        turned = (
            (turns[1:] * turns[:-1].inv()).as_rotvec() / steps if len(steps) else np.zeros((0, 3))
        )
        velocity, turning = (np.vstack([np.zeros((1, 3)), each]) for each in (moved, turned))
        speed = np.linalg.norm(velocity, axis=1)
        turn = np.linalg.norm(turning, axis=1)
        # 1e-9 m/s is far above the rounding of positions over a tick, 1e-13 m/s. Cutting needs a
        # speed: a tool that only turns gets 1 m/s, and its rate in `_headings` is the turning
        # itself.
        self._speeds = np.where(speed > 1e-9, speed, np.where(turn > 1e-9, 1.0, 0.0))
        self._headings = (
            np.stack([velocity, turning], axis=1) / np.maximum(self._speeds, 1e-300)[:, None, None]
        )

    def sweep_m(self) -> Array:
        """Return all positions [m]."""
        return self._tips

    def rotations(self) -> Array:
        """Return all orientations."""
        return self._rotations

    def begin(self, motion: ToolMotion) -> None:
        """Write the first pose."""
        motion.tip_m[:] = self._tips[0]
        motion.rotation[:] = self._rotations[0]
        motion.heading[:] = self._headings[0]

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Write the pose of the tick; after the last pose the tool rests."""
        tick = round(time_s / step_s)
        count = len(self._tips)
        at = min(tick, count - 1)
        motion.tip_m[:] = self._tips[at]
        motion.rotation[:] = self._rotations[at]
        motion.speed_m_s = float(self._speeds[at]) if tick < count else 0.0
        if motion.speed_m_s > 0.0:
            motion.heading[:] = self._headings[at]


class ReplayPoses(GivenPoses):
    """Recorded motion through poses at given times.

    Positions are interpolated linearly, and orientations on the shortest arc.

    Parameters
    ----------
    times_s
        Increasing times [s], shape (n,).
    tips_m
        Tip positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    step_s
        Length of a tick [s]. The table is resampled to ticks once, before the run.
    """

    def __init__(self, times_s: Array, tips_m: Array, quaternions: Array, *, step_s: float) -> None:
        duration_s = float(times_s[-1] - times_s[0])
        ticks: Array = step_s * np.arange(round(duration_s / step_s) + 1, dtype=np.float64)
        at = np.clip(times_s[0] + ticks, times_s[0], times_s[-1])
        tips = np.column_stack([np.interp(at, times_s, tips_m[:, c]) for c in range(3)])
        super().__init__(ticks, tips, Slerp(times_s, Rotation.from_quat(quaternions))(at))
        self.duration_s = duration_s


def read_replay(path: Path, *, step_s: float) -> ReplayPoses:
    """Read poses from a CSV table or an HDF5 recording.

    The CSV table needs ``time_s`` and the pose columns of ``trace.csv``.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, holds values that are not finite, or its times do
        not increase.
    """
    where = _File(path, "motion.file")
    if not is_file(path):
        raise InputError(
            where.what,
            "be an existing file of poses",
            path,
            "give a CSV such as a run's trace.csv",
        )
    if path.suffix.lower() in RECORDINGS:
        held = read_drilling(path, what=where.what)
        poses = np.column_stack([held.times_s, held.tips_m, held.quaternions])
    else:
        poses = _table(where)
    lasts_s = float(poses[-1, 0] - poses[0, 0])
    if lasts_s > LONGEST_S:
        raise where.error(f"last at most {LONGEST_S:g} s", f"{lasts_s:g}", "cut it")
    with names_of_caller({"poses": where.what}):
        return ReplayPoses(poses[:, 0], poses[:, 1:4], poses[:, 4:], step_s=step_s)


MEASURES = ("time", *["length"] * 3, *["number"] * 4)
"""Quantities of the columns of a table of poses."""


def _table(where: _File) -> Array:
    """Return times [s], tips [m] and quaternions of a table of text, shape (n, 8)."""
    table = read_table(where.path, where.what)
    require_distinct_columns(table.names, where.what, where.path)
    measures = dict(zip(("time_s", *POSE_COLUMNS), MEASURES, strict=True))
    headers = {name: column_of(name, each, table.names) for name, each in measures.items()}
    if missing := [name for name, header in headers.items() if header is None]:
        given = ", ".join(table.names[:40])
        raise where.error(f"have the columns {', '.join(missing)}", given, "add them")
    columns = []
    for name, header in headers.items():
        assert header is not None
        factor = UNITS[measures[name]].get(unit_of(header, measures[name]), 1.0)
        columns.append(factor * table.finite(header))
    poses = np.column_stack(columns)
    if len(poses) < 2:
        raise where.error("hold at least two poses", len(poses), "record more")
    # of samples of equal times the first is kept, as of a recording
    poses = poses[np.diff(poses[:, 0], prepend=-np.inf) != 0.0]
    back = np.flatnonzero(np.diff(poses[:, 0]) < 0.0)
    if back.size:
        before, after = poses[back[0] : back[0] + 2, 0]
        raise where.error("have increasing time_s", f"{after:g} after {before:g}", "sort its rows")
    where.require_unit(poses[:, 4:])
    return poses


COLUMNS = 7
"""Columns of a pose: tick, tip [m], axis."""
FORMAT = 2
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


def poses_of_trace(tips_m: Array, axes: Array) -> Array:
    """Build the poses of a run from its trace, where the file of poses is missing.

    The shape of the bone is then accurate to the distance that a tool moves between two cuts.

    Parameters
    ----------
    tips_m, axes
        Tip [m] and axis of the tool at every tick, shape (n, 3).
    """
    poses = np.column_stack([np.arange(len(tips_m)), tips_m, axes])
    return (
        # The pose before tick 0 is the start of the first cut.
        np.vstack([np.append(-1.0, poses[0, 1:]), poses]) if len(poses) else np.zeros((0, COLUMNS))
    )
