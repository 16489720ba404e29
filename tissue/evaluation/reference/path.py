"""The path of a tool as legs, along each of which a point of the world goes straight through the tool's frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue.evaluation.reference.convex_part import ConvexPart

__all__ = ["ToolPath"]

Array = NDArray[np.float64]
STRAIGHT_M = 5e-9
"""How far a point's path through the tool's frame may bend within a leg [m]."""


@dataclass(frozen=True)
class ToolPath:
    """Poses and velocities of a tool, tick by tick.

    Attributes
    ----------
    tips_m
        Tip [m], shape (n, 3).
    rotations
        Tool to world, shape (n, 3, 3).
    velocities
        Velocity of the tip [m/s], shape (n, 3).
    turnings
        Angular velocity of the pose [rad/s], shape (n, 3); the spin is not part of it.
    reach_m
        Farthest that the tool reaches from its tip [m].
    legs
        Ticks at which a leg begins and ends, shape (legs, 2).
    """

    tips_m: Array
    rotations: Array
    velocities: Array
    turnings: Array
    reach_m: float
    legs: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "legs", self._found_legs())

    @classmethod
    def from_quaternions(
        cls, tips_m: Array, quaternions: Array, velocities: Array, turnings: Array, *, reach_m: float
    ) -> "ToolPath":
        """Path with orientations (x, y, z, w), shape (n, 4)."""
        return cls(tips_m, Rotation.from_quat(quaternions).as_matrix(), velocities, turnings, reach_m)

    def in_tool(self, tick: int, points: Array) -> Array:
        """Points of the world [m], shape (n, 3), in the tool's frame at a tick."""
        return (points - self.tips_m[tick]) @ self.rotations[tick]

    def in_world(self, tick: int, points: Array) -> Array:
        """Points of the tool's frame [m], shape (n, 3), in the world at a tick."""
        return self.tips_m[tick] + points @ self.rotations[tick].T

    def swept_distance(self, tick: int, parts: tuple[ConvexPart, ...], points: Array, *, within: Array) -> Array:
        """Signed distance [m] of points in the world, shape (n, 3), from all that the tool has swept before a tick.

        Negative inside. On the leg that the tick belongs to, the first part is left out: of what lies on a convex body
        that advances on a straight path, nothing lay inside it before. Infinite where nothing was swept; of values
        above ``within``, shape (n,) [m], only that is right.
        """
        distance = np.full(len(points), np.inf)
        for start, end in self.legs[self.legs[:, 0] < tick]:
            present = bool(end >= tick)
            if present and len(parts) == 1:
                continue
            begins, ends = self.in_tool(start, points), self.in_tool(min(end, tick), points)
            for part in parts[1:] if present else parts:
                np.minimum(distance, part.least_on_path(begins, ends, within=within), out=distance)
        return distance

    def _found_legs(self) -> NDArray[np.intp]:
        """Ticks joined to legs as long as the paths through the tool's frame are straight and do not turn back."""
        last = len(self.tips_m) - 1
        legs: list[tuple[int, int]] = []
        start = 0
        while start < last:
            end, step = start + 1, 1
            while step:  # the step doubles while the leg stays straight, then halves: few trials for long legs
                if end + step <= last and self._is_straight(start, end + step):
                    end, step = end + step, 2 * step
                else:
                    step //= 2
            legs.append((start, end))
            start = end
        return np.array(legs, dtype=np.intp).reshape(-1, 2)

    def _is_straight(self, start: int, end: int) -> bool:
        """Whether points about the tool go straight and onward through its frame from one tick to another."""
        corners = self.reach_m * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1], [0, 0, 0]], dtype=float)
        world = np.concatenate([self.in_world(start, corners), self.in_world(end, corners)])
        ticks = slice(start, end + 1)
        seen = np.einsum("tpc,tcd->tpd", world[None] - self.tips_m[ticks, None], self.rotations[ticks])
        chord = seen[-1] - seen[0]
        length = np.linalg.norm(chord, axis=1)
        along = chord / np.maximum(length, 1e-300)[:, None]
        progress = np.einsum("tpc,pc->tp", seen - seen[0], along)
        off = seen - seen[0] - progress[..., None] * along
        onward = bool((np.diff(progress, axis=0) >= -STRAIGHT_M).all())
        return onward and bool(np.linalg.norm(off, axis=2).max() <= STRAIGHT_M)
