"""What moves the tool: given feed, given thrust, or a recorded pose table."""

from math import isfinite
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError
from tissue.model import Response, ToolMotion

__all__ = ["LONGEST_S", "FollowPath", "Motion", "PushAlongAxis", "ReplayPoses", "frame_along", "read_poses"]

Array = NDArray[np.float64]
LONGEST_S = 3600.0
"""Longest motion of a run [s]."""
POSE_COLUMNS = ("tool_x_mm", "tool_y_mm", "tool_z_mm", "tool_qx", "tool_qy", "tool_qz", "tool_qw")


class Motion(Protocol):
    """Drives a tool: `advance` writes the pose and motion of the next tick."""

    duration_s: float
    """How long the motion lasts by itself [s]."""

    def sweep_m(self) -> Array:
        """Tip positions that outline where the tool can go [m], shape (n, 3)."""
        ...

    def rotations(self) -> Array:
        """Tool to world at those positions, shape (n, 3, 3)."""
        ...

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Write the pose at ``time_s``, given the response at the previous tick, into ``motion``."""
        ...


def frame_along(axis: tuple[float, float, float]) -> Array:
    """Rotation whose third column is the unit vector along ``axis`` and whose first lies as close to x as it can."""
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = helper - z * (helper @ z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


class FollowPath:
    """Position-driven: the tip follows straight lines at a given feed, then stays.

    Parameters
    ----------
    points_m
        Corners of the path [m], shape (n, 3).
    feed_m_s
        Speed along it [m/s].
    axis
        Direction of the tool's axis from tip to shank.
    """

    def __init__(self, points_m: Array, *, feed_m_s: float, axis: tuple[float, float, float]) -> None:
        legs = np.diff(points_m, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        keep = lengths > 0.0
        if not keep.any():
            raise InputError("motion.points_mm must hold two different points, got only one: add where the tool goes")
        self._starts, self._headings = points_m[:-1][keep], (legs / np.maximum(lengths, 1e-300)[:, None])[keep]
        self._ends_s = np.cumsum(lengths[keep]) / feed_m_s
        self._begins_s = np.concatenate([[0.0], self._ends_s[:-1]])
        self._last = points_m[-1]
        self._feed = feed_m_s
        self._rotation = frame_along(axis)
        self._leg = 0
        self.duration_s = float(self._ends_s[-1])
        self._points = points_m

    def sweep_m(self) -> Array:
        """Corners of the path [m]."""
        return self._points

    def rotations(self) -> Array:
        """The fixed orientation at every corner."""
        return np.broadcast_to(self._rotation, (len(self._points), 3, 3))

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Go along the path."""
        motion.rotation[:] = self._rotation
        while self._leg < len(self._ends_s) and time_s > self._ends_s[self._leg] + 1e-9:
            self._leg += 1
        if self._leg == len(self._ends_s):
            motion.tip_m[:] = self._last
            motion.speed_m_s = 0.0
            return
        heading = self._headings[self._leg]
        motion.heading[0] = heading
        motion.tip_m[:] = self._starts[self._leg] + heading * (self._feed * (time_s - self._begins_s[self._leg]))
        motion.speed_m_s = self._feed


class PushAlongAxis:
    """Force-driven: a thrust pushes the tool down its axis; the feed follows from the balance with the cutting force.

    The cutting force grows so fast with the feed (up to 1e5 N s/m) that an explicit step is unstable for steps longer
    than 2 m / c; the balance is solved for the new speed instead::

        m (v' - v) / dt = thrust - c v' - edge,    v' in [0, greatest feed]

    Below the edge force the tool stays where it is and the bone answers the thrust.

    Parameters
    ----------
    start_m
        Where the tip starts [m].
    axis
        Direction from tip to shank; the tool moves against it.
    thrust_N, mass_kg, max_feed_m_s
        Push, moving mass and greatest feed.
    depth_m
        Coordinate along ``-axis`` from the site's origin at which the feed stops [m].
    """

    def __init__(
        self,
        start_m: Array,
        *,
        axis: tuple[float, float, float],
        thrust_N: float,
        mass_kg: float,
        max_feed_m_s: float,
        depth_m: float,
    ) -> None:
        self._rotation = frame_along(axis)
        self._heading = -self._rotation[:, 2]
        self._thrust, self._mass, self._max_feed = thrust_N, mass_kg, max_feed_m_s
        self._start = np.asarray(start_m, dtype=float)
        self._travel = 0.0
        self._longest = depth_m - float(self._start @ self._heading)
        if self._longest <= 0.0:
            raise InputError(
                f"motion.depth_mm must be greater than the depth of motion.start_mm along the feed "
                f"({1e3 * float(self._start @ self._heading):g}), got {1e3 * depth_m:g}: start higher or go deeper"
            )
        self._speed = 0.0
        self.duration_s = 4.0 * self._longest / max_feed_m_s

    def sweep_m(self) -> Array:
        """Start and deepest position [m]."""
        return np.stack([self._start, self._start + self._longest * self._heading])

    def rotations(self) -> Array:
        """The fixed orientation at both."""
        return np.broadcast_to(self._rotation, (2, 3, 3))

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Solve the balance along the axis for the new speed and move."""
        drag = max(-float(response.resistance[:3] @ self._heading), 0.0)
        edge = max(-float(response.edge[:3] @ self._heading), 0.0)
        self._speed = implicit_speed(
            self._speed, thrust=self._thrust - edge, drag=drag, mass=self._mass, step_s=step_s
        )
        self._speed = max(min(self._speed, self._max_feed, (self._longest - self._travel) / step_s), 0.0)
        self._travel += self._speed * step_s
        motion.rotation[:] = self._rotation
        motion.tip_m[:] = self._start + self._travel * self._heading
        motion.heading[0] = self._heading
        motion.speed_m_s = self._speed


def implicit_speed(speed: float, *, thrust: float, drag: float, mass: float, step_s: float) -> float:
    """Speed [m/s] one implicit Euler step later of a mass under ``thrust`` [N] and a viscous ``drag`` [N s/m]."""
    return (mass * speed / step_s + thrust) / (mass / step_s + drag)


class ReplayPoses:
    """Recorded motion: poses at given times, linear and on the shortest arc between them.

    Parameters
    ----------
    times_s
        Increasing times [s], shape (n,).
    tips_m
        Tip positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    step_s
        Length of a tick [s]; the table is brought to ticks once, before the run.
    """

    def __init__(self, times_s: Array, tips_m: Array, quaternions: Array, *, step_s: float) -> None:
        from scipy.spatial.transform import Rotation, Slerp

        self.duration_s = float(times_s[-1] - times_s[0])
        count = int(round(self.duration_s / step_s)) + 1
        at = np.clip(times_s[0] + step_s * np.arange(-1, count), times_s[0], times_s[-1])
        turned = Slerp(times_s, Rotation.from_quat(quaternions))(at)
        tips = np.column_stack([np.interp(at, times_s, tips_m[:, c]) for c in range(3)])
        self._tips, self._rotations = tips[1:], turned.as_matrix()[1:]
        velocity = np.diff(tips, axis=0) / step_s
        turning = (turned[1:] * turned[:-1].inv()).as_rotvec() / step_s
        speed, turn = np.linalg.norm(velocity, axis=1), np.linalg.norm(turning, axis=1)
        self._speeds = np.where(speed > 1e-9, speed, np.where(turn > 1e-9, 1.0, 0.0))
        self._headings = np.stack([velocity, turning], axis=1) / np.maximum(self._speeds, 1e-300)[:, None, None]
        self._step = step_s

    def sweep_m(self) -> Array:
        """All positions [m]."""
        return self._tips

    def rotations(self) -> Array:
        """All orientations."""
        return self._rotations

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Take the recorded pose; the velocity is the difference to the pose one tick earlier."""
        tick = min(int(round(time_s / self._step)), len(self._tips) - 1)
        motion.tip_m[:] = self._tips[tick]
        motion.rotation[:] = self._rotations[tick]
        motion.speed_m_s = float(self._speeds[tick]) if time_s <= self.duration_s + 1e-9 else 0.0
        if motion.speed_m_s > 0.0:
            motion.heading[:] = self._headings[tick]


def read_poses(path: Path, *, step_s: float) -> ReplayPoses:
    """Read a pose table: CSV with ``time_s`` and the tool's pose in the columns of ``trace.csv``.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, holds values that are not finite, or its times do not increase.
    """
    import csv

    if not path.is_file():
        raise InputError(f"motion.file must be an existing table, got {path}: give a CSV such as a run's trace.csv")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            missing = [name for name in ("time_s", *POSE_COLUMNS) if name not in names]
            rows = [] if missing else [_pose(row, reader.line_num, path) for row in reader]
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"motion.file must be a CSV table, got other data in {path}: export it as text") from None
    if missing:
        raise InputError(f"motion.file must have the columns {', '.join(missing)}, got {path} without them: add them")
    if len(rows) < 2:
        raise InputError(f"motion.file must hold at least two poses, got {len(rows)} in {path}: record more")
    poses = np.array(rows)
    back = np.flatnonzero(np.diff(poses[:, 0]) <= 0.0)
    if back.size:
        before, after = poses[back[0] : back[0] + 2, 0]
        raise InputError(
            f"motion.file must have increasing time_s, got {after:g} after {before:g} in {path}: sort its rows"
        )
    if poses[-1, 0] - poses[0, 0] > LONGEST_S:
        raise InputError(
            f"motion.file must last at most {LONGEST_S:g} s, got {poses[-1, 0] - poses[0, 0]:g} in {path}: cut it"
        )
    if (np.linalg.norm(poses[:, 4:], axis=1) < 1e-6).any():
        raise InputError(f"motion.file must hold unit quaternions, got a zero one in {path}: use 0, 0, 0, 1 for no turn")
    return ReplayPoses(poses[:, 0], poses[:, 1:4] * 1e-3, poses[:, 4:], step_s=step_s)


def _pose(row: dict[str, str], line: int, path: Path) -> list[float]:
    """Time and pose of one row."""
    values = []
    for name in ("time_s", *POSE_COLUMNS):
        try:
            value = float(row[name])
        except (TypeError, ValueError):
            value = float("nan")
        if not isfinite(value):
            raise InputError(
                f"motion.file must hold finite numbers, got {row[name] or 'nothing'} for {name} in line {line} of "
                f"{path}: mend that line"
            )
        values.append(value)
    return values
