"""Interface of tool motions, motion along a path, and conversion of rotations.

Quaternions are (x, y, z, w).
"""

from math import inf
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.models.tissue_model import Response, TissueModel, ToolMotion
from tissue.motion.quaternion import OFF_UNIT, of_matrix

LONGEST_S = 3600.0
"""Longest motion of a run [s]: an hour, 3.6 million ticks.

A longer motion probably has a wrong unit.
"""


Events = list[tuple[float, str]]
"""Events, each as time [s] and a sentence."""


class Motion(Protocol):
    """Interface of tool motions.

    `begin` writes the first pose. In every tick, `advance` first writes the pose, and `play` then
    receives the tissue's response to it.
    """

    duration_s: float
    """Duration of the motion [s]."""
    after_s: float = 0.0
    """Part of `duration_s` that is added for the delay of a simulated hand [s]."""
    measure_names: tuple[str, ...] = ()
    """Names, with units, of the columns that the motion adds to the trace."""
    measures: Array = np.zeros(0)
    """Values of the columns `measure_names` at the present tick."""
    model_ticks: int = 1
    """Number of ticks in which the same tissue response is used."""
    notes: tuple[str, ...] = ()
    """Findings about the file from which the motion was read, in sentences."""
    balances: bool = False
    """True if the pose in a tick depends on the tissue force at this pose.

    If True, `correct` searches for the pose before tissue is removed.
    """

    @property
    def feed_limit(self) -> dict[str, float | None]:
        """Record of how long the feed limit determined the speed in contact.

        The record contains the feed limit ``max_feed_mm_s``, and the total time ``active_s`` for
        which it was active in contact [s]. ``first_s`` is the time at which the limit first became
        active [s], or None if it never did. The limit is active if the thrust exceeds the
        resistance of the tissue. A motion that is not driven by a thrust has an empty record.
        """
        return {}

    def sweep_m(self) -> Array:
        """Return tip positions [m], shape (n, 3), whose bounding box contains all tip positions."""
        ...

    def rotations(self) -> Array:
        """Return the rotations from tool to world at the points of `sweep_m`, shape (n, 3, 3)."""
        ...

    def set_tissue(self, tissue: TissueModel) -> None:
        """Receive the tissue model before the start of the motion."""
        return

    def begin(self, motion: ToolMotion) -> None:
        """Write the start pose and the direction of motion into ``motion``, with zero speed."""
        motion.tip_m[:] = self.sweep_m()[0]
        motion.rotation[:] = self.rotations()[0]

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Write the pose at ``time_s`` into ``motion``.

        ``response`` is the response of the tissue in the previous tick.
        """
        ...

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Correct the pose within the tick if the tissue response at the new pose requires it.

        Return True if the tool moved. If the attribute `balances` of the motion is True, the method
        is called until it returns False.
        """
        return False

    def play(self, response: Response) -> None:
        """Receive the tissue response at the present tick."""
        return

    def happened(self) -> Events:
        """Return the events so far, each as time [s] and a sentence."""
        return []


def first_off_unit(quaternions: Array) -> int | None:
    """Return the index of the first quaternion that is far from unit length, or None.

    Parameters
    ----------
    quaternions
        Finite quaternions, shape (n, 4).
    """
    off: Array = np.abs(np.einsum("ij,ij->i", quaternions, quaternions) - 1.0)
    wrong = np.flatnonzero(off > OFF_UNIT)
    return int(wrong[0]) if wrong.size else None


def frame_along(axis: ArrayLike) -> Array:
    """Return a rotation matrix whose third column is along ``axis`` and whose first is near x.

    If the angle between ``axis`` and x is below about 26°, the first column is near y instead.
    """
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = helper - z * (helper @ z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def matrix_of(quaternion: Array) -> Array:
    """Return the rotation matrix of a unit quaternion, shape (3, 3)."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Return the unit quaternion with w >= 0 of a rotation matrix, shape (4,)."""
    return np.array(of_matrix(rotation.tolist()))


class FollowPath(Motion):
    """Motion along straight lines with a given feed.

    The tool rests at the end of the path.

    Parameters
    ----------
    points_m
        Corners of the path [m], shape (n, 3).
    feed_m_s
        Speed along the path [m/s].
    axis
        Direction of the tool's axis from tip to shank.
    """

    def __init__(
        self, points_m: Array, *, feed_m_s: float, axis: tuple[float, float, float]
    ) -> None:
        legs = np.diff(points_m, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        # Repeated corners have no direction. 1e-300 avoids a division by zero.
        keep = lengths > 0.0
        if not keep.any():
            raise InputError(
                "motion.points_mm",
                "contain at least two different points",
                "only one",
                "add the point to which the tool moves",
            )
        self._starts = points_m[:-1][keep]
        self._headings = (legs / np.maximum(lengths, 1e-300)[:, None])[keep]
        self._ends_s = np.cumsum(lengths[keep]) / feed_m_s
        self._begins_s = np.concatenate([[0.0], self._ends_s[:-1]])
        self._last = points_m[-1]
        self._feed = feed_m_s
        self._rotation = frame_along(axis)
        self._leg = 0
        self.duration_s = float(self._ends_s[-1])
        self._points = points_m

    def sweep_m(self) -> Array:
        """Return the corners of the path [m]."""
        return self._points

    def rotations(self) -> Array:
        """Return the fixed orientation at every corner."""
        return np.broadcast_to(self._rotation, (len(self._points), 3, 3))

    def begin(self, motion: ToolMotion) -> None:
        """Write the pose at the first corner of the path; the speed is zero."""
        super().begin(motion)
        motion.heading[0] = self._headings[0]

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move the tool along the path."""
        motion.rotation[:] = self._rotation
        # 1e-9 s: the time of a tick is rounded, and a leg may end exactly at a tick.
        while self._leg < len(self._ends_s) and time_s > self._ends_s[self._leg] + 1e-9:
            self._leg += 1
        if self._leg == len(self._ends_s):
            motion.tip_m[:] = self._last
            motion.speed_m_s = 0.0
            return
        heading = self._headings[self._leg]
        motion.heading[0] = heading
        motion.tip_m[:] = self._starts[self._leg] + heading * (
            self._feed * (time_s - self._begins_s[self._leg])
        )
        motion.speed_m_s = self._feed


class StaysAt(Motion):
    """Motion of a tool at rest.

    Parameters
    ----------
    start_m
        Position of the tip [m].
    axis
        Direction of the tool's axis from tip to shank.
    """

    duration_s = inf

    def __init__(self, start_m: Array, axis: ArrayLike) -> None:
        self._tip = np.array(start_m, dtype=np.float64)
        self._rotation = frame_along(axis)

    def sweep_m(self) -> Array:
        """Return the only position [m]."""
        return self._tip[None]

    def rotations(self) -> Array:
        """Return the only orientation."""
        return self._rotation[None]

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Do nothing: the tool stays at rest."""
