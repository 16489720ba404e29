"""What moves the tool: given feed or given thrust; rotations of a tool, matrices, as quaternions (x, y, z, w)."""

from math import sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.quaternion import OFF_UNIT

__all__ = [
    "LONGEST_S",
    "FollowPath",
    "Motion",
    "PushAlongAxis",
    "first_off_unit",
    "frame_along",
    "matrix_of",
    "quaternion_of",
]

Array = NDArray[np.float64]
LONGEST_S = 3600.0
"""Longest motion of a run [s]."""


class Motion(Protocol):
    """Drives a tool: `begin` writes its first pose, then `advance` the pose of every tick and `play` its answer."""

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
        """Write the pose at ``time_s``, given the response at the previous tick, into ``motion``."""
        ...

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Move the tool once more within the tick, if the answer to its new pose asks for that; whether it did."""
        return False

    def play(self, response: Response) -> None:
        """Do what follows from the tissue's answer at the present tick."""
        return

    def happened(self) -> list[tuple[float, str]]:
        """What has happened so far: time [s] and a sentence each."""
        return []


def first_off_unit(quaternions: Array) -> int | None:
    """Return the place of the first quaternion that is far from unit length; None where all are near it.

    Parameters
    ----------
    quaternions
        Shape (n, 4), finite.
    """
    off: Array = np.abs(np.einsum("ij,ij->i", quaternions, quaternions) - 1.0)
    wrong = np.flatnonzero(off > OFF_UNIT)
    return int(wrong[0]) if wrong.size else None


def frame_along(axis: tuple[float, float, float]) -> Array:
    """Rotation whose third column is the unit vector along ``axis`` and whose first lies as close to x as it can."""
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

    From the largest of its four components, so that no small number is divided by (Shepperd 1978, J. Guid. Control
    1:223).
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

    def begin(self, motion: ToolMotion) -> None:
        """Start at the first corner."""
        motion.tip_m[:], motion.rotation[:] = self._starts[0], self._rotation
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
        motion.tip_m[:] = self._starts[self._leg] + heading * (self._feed * (time_s - self._begins_s[self._leg]))
        motion.speed_m_s = self._feed


class PushAlongAxis(Motion):
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

    def begin(self, motion: ToolMotion) -> None:
        """Begin at the start."""
        motion.tip_m[:], motion.rotation[:] = self._start, self._rotation
        motion.heading[0] = self._heading

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Solve the balance along the axis for the new speed and move."""
        drag = max(-float(response.resistance[:3].dot(self._heading)), 0.0)
        edge = max(-float(response.edge[:3].dot(self._heading)), 0.0)
        self._speed = implicit_speed(self._speed, thrust=self._thrust - edge, drag=drag, mass=self._mass, step_s=step_s)
        self._speed = max(min(self._speed, self._max_feed, (self._longest - self._travel) / step_s), 0.0)
        self._travel += self._speed * step_s
        motion.rotation[:] = self._rotation
        motion.tip_m[:] = self._start + self._travel * self._heading
        motion.heading[0] = self._heading
        motion.speed_m_s = self._speed
        stuck = self._speed == 0.0 and self._travel < self._longest and edge > 0.0
        motion.pressed = min(self._thrust / edge, 1.0) if stuck else 0.0


def implicit_speed(speed: float, *, thrust: float, drag: float, mass: float, step_s: float) -> float:
    """Speed [m/s] one implicit Euler step later of a mass under ``thrust`` [N] and a viscous ``drag`` [N s/m]."""
    return (mass * speed / step_s + thrust) / (mass / step_s + drag)
