"""Motion of a tool along a given path; rotations of a tool, matrices, as quaternions (x, y, z,
w).
"""

from dataclasses import dataclass
from math import sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.quaternion import OFF_UNIT

__all__ = [
    "LONGEST_S",
    "FeedLimit",
    "FollowPath",
    "Motion",
    "first_off_unit",
    "frame_along",
    "matrix_of",
    "quaternion_of",
]

Array = NDArray[np.float64]
LONGEST_S = 3600.0
"""Longest motion of a run [s]."""


@dataclass(frozen=True)
class FeedLimit:
    """Time for which the feed limit, and not the thrust, set the speed of a tool in contact.

    Attributes
    ----------
    max_feed_mm_s
        The limit.
    active_s
        Time in contact with the limit active; the tissue then resists with less than the thrust.
    first_s
        When it was first active; None if it never was.
    """

    max_feed_mm_s: float
    active_s: float
    first_s: float | None


class Motion(Protocol):
    """Drives a tool: `begin` writes its first pose, then `advance` the pose of every tick and
    `play` its answer.
    """

    duration_s: float
    """How long the motion lasts by itself [s]."""
    after_s: float = 0.0
    """How much of that is a hand's being late [s]."""
    measure_names: tuple[str, ...] = ()
    """Names, with units, of the motion's own columns in the trace."""
    measures: Array = np.zeros(0)
    """Their values at the present tick."""
    model_ticks: int = 1
    """Ticks for which one answer of the tissue holds."""
    balances: bool = False
    """Whether the pose follows from the force at that pose; `correct` then searches for it
    before a cut is made.
    """

    @property
    def feed_limit(self) -> FeedLimit | None:
        """Time for which a limit of the feed, and not a thrust, set the speed; None for a motion
        without a thrust.
        """
        return None

    def sweep_m(self) -> Array:
        """Tip positions that outline where the tool can go [m], shape (n, 3)."""
        ...

    def rotations(self) -> Array:
        """Tool to world at those positions, shape (n, 3, 3)."""
        ...

    def begin(self, motion: ToolMotion) -> None:
        """Write the pose at the start and the heading there into ``motion``, at rest."""
        ...

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Write the pose at ``time_s``, given the response at the previous tick, into
        ``motion``.
        """
        ...

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Move the tool once more within the tick, if the answer to its new pose asks for that;
        whether it did.

        A motion that `balances` is asked until it returns False.
        """
        return False

    def play(self, response: Response) -> None:
        """Do what follows from the tissue's answer at the present tick."""
        return

    def happened(self) -> list[tuple[float, str]]:
        """What has happened so far: time [s] and a sentence each."""
        return []


def first_off_unit(quaternions: Array) -> int | None:
    """Return the place of the first quaternion that is far from unit length; None where all are
    near it.

    Parameters
    ----------
    quaternions
        Shape (n, 4), finite.
    """
    off: Array = np.abs(np.einsum("ij,ij->i", quaternions, quaternions) - 1.0)
    wrong = np.flatnonzero(off > OFF_UNIT)
    return int(wrong[0]) if wrong.size else None


def frame_along(axis: tuple[float, float, float]) -> Array:
    """Rotation whose third column is the unit vector along ``axis`` and whose first lies as
    close to x as it can.
    """
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = helper - z * (helper @ z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def matrix_of(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion, shape (3, 3)."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion with w >= 0 of a rotation matrix, shape (3, 3).

    From the largest of its four components, so that no small number is divided by (Shepperd 1978,
    J. Guid. Control 1:223).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    largest = squares.index(max(squares))
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    quaternion = np.array(rows[largest]) / (2.0 * sqrt(squares[largest]))
    return quaternion if quaternion[3] >= 0.0 else -quaternion


class FollowPath(Motion):
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

    def __init__(
        self, points_m: Array, *, feed_m_s: float, axis: tuple[float, float, float]
    ) -> None:
        legs = np.diff(points_m, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        keep = lengths > 0.0
        if not keep.any():
            raise InputError(
                "motion.points_mm",
                "hold two different points",
                "only one",
                "add where the tool goes",
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
        """Corners of the path [m]."""
        return self._points

    def rotations(self) -> Array:
        """The fixed orientation at every corner."""
        return np.broadcast_to(self._rotation, (len(self._points), 3, 3))

    def begin(self, motion: ToolMotion) -> None:
        """Start at the first corner."""
        motion.tip_m[:] = self._starts[0]
        motion.rotation[:] = self._rotation
        motion.heading[0] = self._headings[0]

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
        motion.tip_m[:] = self._starts[self._leg] + heading * (
            self._feed * (time_s - self._begins_s[self._leg])
        )
        motion.speed_m_s = self._feed
