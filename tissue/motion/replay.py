"""Recorded motion: replay of a table of poses or of a recording of volumetric_drilling."""

import csv
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.base.text_tables import number_in, require_distinct_columns
from meshes.paths.toolpath import POSE_COLUMNS
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.drilling_recording import read_drilling
from tissue.motion.motion import LONGEST_S, Motion, first_off_unit

__all__ = ["GivenPoses", "ReplayPoses", "read_replay"]

Array = NDArray[np.float64]
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
    if not is_file(path):
        raise InputError(
            "motion.file",
            "be an existing file of poses",
            path,
            "give a CSV such as a run's trace.csv",
        )
    if path.suffix.lower() in RECORDINGS:
        held = read_drilling(path, what="motion.file")
        _require_short(float(held.times_s[-1]), path)
        with names_of_caller({"poses": "motion.file"}):
            return ReplayPoses(held.times_s, held.tips_m, held.quaternions, step_s=step_s)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            require_distinct_columns(names, "motion.file", path)
            missing = [name for name in ("time_s", *POSE_COLUMNS) if name not in names]
            rows = [] if missing else [_pose(row, reader.line_num, path) for row in reader]
    except (UnicodeDecodeError, csv.Error):
        raise InputError(
            "motion.file", "be a CSV table", f"other data in {path}", "export it as text"
        ) from None
    if missing:
        raise InputError(
            "motion.file",
            f"have the columns {', '.join(missing)}",
            f"{path} without them",
            "add them",
        )
    if len(rows) < 2:
        raise InputError(
            "motion.file", "hold at least two poses", f"{len(rows)} in {path}", "record more"
        )
    poses = np.array(rows)
    back = np.flatnonzero(np.diff(poses[:, 0]) <= 0.0)
    if back.size:
        before, after = poses[back[0] : back[0] + 2, 0]
        raise InputError(
            "motion.file",
            "have increasing time_s",
            f"{after:g} after {before:g} in {path}",
            "sort its rows",
        )
    _require_short(poses[-1, 0] - poses[0, 0], path)
    if (wrong := first_off_unit(poses[:, 4:])) is not None:
        length = float(np.linalg.norm(poses[wrong, 4:]))
        raise InputError(
            "motion.file",
            "hold unit quaternions",
            f"one of length {length:.4g} at {poses[wrong, 0]:g} s in {path}",
            "give tool_qx, tool_qy, tool_qz and tool_qw of a rotation, and 0, 0, 0, 1 for none",
        )
    with names_of_caller({"poses": "motion.file"}):
        return ReplayPoses(poses[:, 0], poses[:, 1:4] * 1e-3, poses[:, 4:], step_s=step_s)


def _require_short(lasts_s: float, path: Path) -> None:
    """Check that the motion is not longer than `LONGEST_S`."""
    if lasts_s > LONGEST_S:
        raise InputError(
            "motion.file", f"last at most {LONGEST_S:g} s", f"{lasts_s:g} in {path}", "cut it"
        )


def _pose(row: dict[str, str], line: int, path: Path) -> list[float]:
    """Return time and pose of one row."""
    values = []
    for name in ("time_s", *POSE_COLUMNS):
        try:
            value = number_in(row[name])
        except (TypeError, ValueError):
            value = float("nan")
        if not isfinite(value):
            raise InputError(
                "motion.file",
                "hold finite numbers",
                f"{row[name] or 'nothing'} for {name} in line {line} of {path}",
                "fix that line",
            )
        values.append(value)
    return values
