"""Replay of recorded motion: a table of poses, or a recording of volumetric_drilling."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted, enumerated, is_file, names_of_caller
from meshes.base.file_limits import read_npz
from meshes.base.tables import read_table
from meshes.base.text_tables import require_distinct_columns
from meshes.base.units import UNITS, column_of, unit_of
from meshes.base.whole_file import whole_file
from meshes.paths.toolpath import POSE_COLUMNS
from meshes.voxels.volume import VoxelVolume
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.motion.drilling_recording import RECORDINGS, PoseFile, read_drilling
from tissue.motion.motion import LONGEST_S, Motion

FARTHEST_M = 10.0
"""Largest extent of a motion along a coordinate axis [m].

The motion of a tool in a patient is less than a metre.
"""


class GivenPoses(Motion):
    """Motion of a tool through given poses, one pose per tick.

    The velocity at a pose is the difference from the previous pose, divided by the time between the
    two poses.

    Parameters
    ----------
    times_s
        Increasing times of the poses [s], shape (n,).
    tips_m
        Tip positions [m], shape (n, 3).
    rotations
        Orientations of the tool, one for each pose.

    Raises
    ------
    InputError
        If the extent of the positions along a coordinate axis is larger than `FARTHEST_M`.
    """

    def __init__(self, times_s: Array, tips_m: Array, rotations: Rotation) -> None:
        extent_m = float(np.ptp(tips_m, axis=0).max())
        if extent_m > FARTHEST_M:
            # Carving visits the whole swept region, so one damaged number would take endless
            # time.
            raise InputError(
                "poses",
                f"lie within {FARTHEST_M:g} m of each other",
                f"{extent_m:.3g} m",
                "leave damaged rows out, and check the unit of the positions",
            )
        self.duration_s = float(times_s[-1] - times_s[0])
        self._tips = tips_m
        self._rotations = rotations.as_matrix()
        steps = np.diff(times_s)[:, None]
        moved = np.diff(tips_m, axis=0) / steps
        turned = (
            (rotations[1:] * rotations[:-1].inv()).as_rotvec() / steps
            if len(steps)
            else np.zeros((0, 3))
        )
        velocity, turning = (np.vstack([np.zeros((1, 3)), each]) for each in (moved, turned))
        speed = np.linalg.norm(velocity, axis=1)
        turn = np.linalg.norm(turning, axis=1)
        # 1e-9 m/s is far above the speed 1e-13 m/s that rounding of positions causes. Cutting needs
        # a speed. For a tool that only turns, the speed is set to 1 m/s, and the second row of
        # `_headings` is the angular velocity.
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
        super().begin(motion)
        motion.heading[:] = self._headings[0]

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Write the pose of a tick; after the last pose the tool rests."""
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

    The poses are resampled to ticks before the run. Positions are interpolated linearly, and
    orientations are interpolated along the shortest rotation.

    Parameters
    ----------
    times_s
        Increasing times of the poses [s], shape (n,).
    tips_m
        Tip positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    notes
        Findings about the pose file, in sentences.
    """

    def __init__(
        self,
        times_s: Array,
        tips_m: Array,
        quaternions: Array,
        *,
        notes: tuple[str, ...] = (),
    ) -> None:
        duration_s = float(times_s[-1] - times_s[0])
        ticks: Array = TICK_S * np.arange(round(duration_s / TICK_S) + 1, dtype=np.float64)
        at = np.clip(times_s[0] + ticks, times_s[0], times_s[-1])
        tips = np.column_stack([np.interp(at, times_s, tips_m[:, c]) for c in range(3)])
        super().__init__(ticks, tips, Slerp(times_s, Rotation.from_quat(quaternions))(at))
        self.duration_s = duration_s
        self.notes = notes


def read_replay(path: Path) -> ReplayPoses:
    """Read poses from a CSV table or an HDF5 recording.

    The CSV table needs ``time_s`` and the pose columns of ``trace.csv``.

    Raises
    ------
    InputError
        If the file is missing, has too few columns or values that are not finite, or has times that
        do not increase.
    """
    where = PoseFile(path, "motion.file")
    if not is_file(path):
        raise InputError(
            where.argument,
            "be an existing file of poses",
            path,
            "give a CSV such as a run's trace.csv",
        )
    if path.suffix.lower() in RECORDINGS:
        held = read_drilling(path, argument=where.argument)
        poses = np.column_stack([held.times_s, held.tips_m, held.quaternions])
        notes = held.notes
    else:
        poses, notes = _table(where)
    lasts_s = float(poses[-1, 0] - poses[0, 0])
    if lasts_s > LONGEST_S:
        raise where.error(f"last at most {LONGEST_S:g} s", f"{lasts_s:g} s", "shorten it")
    with names_of_caller({"poses": where.argument}):
        return ReplayPoses(poses[:, 0], poses[:, 1:4], poses[:, 4:], notes=notes)


MEASURES = ("time", *["length"] * 3, *["number"] * 4)
"""Key in `meshes.base.units.UNITS` for each column of a table of poses."""


def _table(where: PoseFile) -> tuple[Array, tuple[str, ...]]:
    """Read a text table.

    Returns
    -------
    Array of times [s], tips [m] and quaternions, shape (n, 8), and notes.
    """
    table = read_table(where.path, where.argument)
    require_distinct_columns(table.names, where.argument, where.path)
    measures = dict(zip(("time_s", *POSE_COLUMNS), MEASURES, strict=True))
    headers: dict[str, str] = {}
    for name, measure in measures.items():
        header = column_of(name, measure, table.names)
        if header is not None:
            headers[name] = header
    if missing := [name for name in measures if name not in headers]:
        given = enumerated(table.names[:40])
        noun = "column" if len(missing) == 1 else "columns"
        raise where.error(f"have the {noun} {enumerated(missing)}", given, "add the missing data")
    columns = []
    for name, header in headers.items():
        factors = UNITS[measures[name]]
        factor = factors.get(unit_of(header, measures[name]), 1.0)
        columns.append(factor * table.finite(header))
    poses = np.column_stack(columns)
    if len(poses) < 2:
        raise where.error("contain at least two poses", len(poses), "record more")
    notes = list(table.notes)
    is_new = np.diff(poses[:, 0], prepend=-np.inf) != 0.0
    if equal := int((~is_new).sum()):
        notes.append(f"{counted(equal, 'pose')} left out with the same time as the pose before")
    poses = poses[is_new]
    back = np.flatnonzero(np.diff(poses[:, 0]) < 0.0)
    if back.size:
        before, after = poses[back[0] : back[0] + 2, 0]
        raise where.error(
            "have increasing values of time_s", f"{after:g} after {before:g}", "sort its rows"
        )
    where.require_unit(poses[:, 4:])
    return poses, tuple(notes)


COLUMNS = 7
"""Number of columns of a pose: tick, tip [m], axis."""
FORMAT = 2
"""Version of the pose file."""


def write_poses(path: Path, poses: Array, volume: VoxelVolume) -> None:
    """Write a tool's poses, and the grid of the voxels that it cuts, to a .npz file.

    The grid is given by its origin and its spacing.
    """
    with whole_file(path) as temporary, temporary.open("wb") as file:
        arrays = {
            "poses": poses,
            "origin_m": volume.origin_m,
            "spacing_m": np.array(volume.spacing_m),
        }
        np.savez_compressed(file, format=np.array(FORMAT), **arrays)  # type: ignore[arg-type]


def read_poses(path: Path) -> tuple[Array, Array, float]:
    """Read the poses, and the origin [m], shape (3,), and spacing [m] of the voxels.

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
    except Exception:  # NumPy and zipfile raise many kinds of errors for a damaged archive
        is_whole = False
        version = FORMAT
    if version != FORMAT or not is_whole:
        raise InputError(
            "poses",
            f"be a complete file of format {FORMAT} that a run wrote",
            path,
            "run the scene again",
        )
    return poses, origin, spacing


def poses_of_trace(tips_m: Array, axes: Array) -> Array:
    """Build the poses of a run from its trace, as a substitute for a missing pose file.

    If the shape of the cut bone is computed from these poses, its error is about the distance that
    the tool moves between two cuts.

    Parameters
    ----------
    tips_m, axes
        Tip [m] and axis of the tool at every tick, each of shape (n, 3).
    """
    poses = np.column_stack([np.arange(len(tips_m)), tips_m, axes])
    return (
        # The pose before tick 0 is the start of the first cut.
        np.vstack([np.append(-1.0, poses[0, 1:]), poses]) if len(poses) else np.zeros((0, COLUMNS))
    )
