"""Path of a tool through a solid: convex parts of the tool, and distance from the swept volume.

The distance of a point from a convex body is a convex function of the position of the point. Along
a straight path, it therefore has one minimum, which golden-section search finds. For a ball, the
minimum is the distance of the centre of the ball from the path, minus the radius.
"""

from dataclasses import dataclass, field
from math import pi

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.cutters.profile import Arc, Line, Piece, Profile

GOLDEN = 0.6180339887498949
RESOLUTION_M = 1e-12
"""Precision [m] of the search for the nearest position on a path."""
STRAIGHT_M = 5e-9
"""Largest deviation [m] from a straight line in a straight part (leg) of a tool path.

The line is the path of a fixed point in the frame of the tool.

The value is far below a chip thickness, which is 0.1 um or more.
"""


@dataclass(frozen=True)
class ConvexPart:
    """Convex body of revolution about the z axis, described by its half section.

    Attributes
    ----------
    pieces
        Arcs and segments of the half section, from the lowest point on the axis to the highest.
    ball
        True if the body is a ball.
    """

    pieces: tuple[Piece, ...]
    ball: bool

    @property
    def bounding_ball(self) -> tuple[float, float]:
        """Centre height [m] and radius [m] of a ball that contains the body."""
        # 64 parts of each piece
        share = np.linspace(0.0, 1.0, 65)
        outline = np.concatenate([piece.at(share)[0] for piece in self.pieces])
        centre = 0.5 * (outline[:, 1].min() + outline[:, 1].max())
        # an arc of half a turn bulges by 3e-4 of its radius between 65 samples
        slack = 1e-3 * np.abs(outline).max()
        return centre, np.hypot(outline[:, 0], outline[:, 1] - centre).max() + slack

    def distance(self, points: Array) -> Array:
        """Return the signed distance of points from the body [m], shape (n,), negative inside.

        The points [m], shape (n, 3), are in the tool's frame.
        """
        section = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
        seen = [_seen(piece, section) for piece in self.pieces]
        lengths, sides = (np.stack(values) for values in zip(*seen, strict=True))
        least = lengths.min(axis=0)
        # At a corner two pieces are equally near; in front of either is outside.
        outside = ((lengths <= least + 1e-12) & (sides > 0.0)).any(axis=0)
        return np.where(outside, least, -least)

    def least_on_path(self, start: Array, end: Array, *, limit_m: Array) -> Array:
        """Return each moving point's smallest signed distance [m] from the body along its path.

        The points move straight from ``start`` to ``end``, shape (n, 3) [m]. A result that is
        larger than ``limit_m``, shape (n,) [m], is only a lower bound of the distance.
        """
        height, radius = self.bounding_ball
        bound = _to_segment(np.array([0.0, 0.0, height]), start, end) - radius
        # the distance of a ball's centre from the path is exact; other bodies need a search
        if self.ball:
            arc = self.pieces[0]
            assert isinstance(arc, Arc)
            return _to_segment(np.array([0.0, 0.0, arc.centre[1]]), start, end) - arc.radius
        near = np.flatnonzero(bound < limit_m)
        if len(near):
            bound[near] = self._search(start[near], end[near] - start[near])
        return bound

    def _search(self, start: Array, along: Array) -> Array:
        """Return the smallest distance at ``start + share * along`` over all shares in [0, 1].

        The method is golden-section search.
        """
        low = np.zeros(len(start))
        high = np.ones(len(start))
        longest = np.linalg.norm(along, axis=1).max()
        ends = np.minimum(self.distance(start), self.distance(start + along))
        left = high - GOLDEN
        right = low + GOLDEN
        at_left = self.distance(start + left[:, None] * along)
        at_right = self.distance(start + right[:, None] * along)
        for _ in range(
            max(int(np.log(max(longest, RESOLUTION_M) / RESOLUTION_M) / -np.log(GOLDEN)), 1)
        ):
            lower = at_left < at_right
            low = np.where(lower, low, left)
            high = np.where(lower, right, high)
            width = GOLDEN * (high - low)
            kept = np.where(lower, left, right)
            at_kept = np.where(lower, at_left, at_right)
            new = np.where(lower, high - width, low + width)
            at_new = self.distance(start + new[:, None] * along)
            left = np.where(lower, new, kept)
            right = np.where(lower, kept, new)
            at_left = np.where(lower, at_new, at_kept)
            at_right = np.where(lower, at_kept, at_new)
        return np.minimum(ends, np.minimum(at_left, at_right))


def convex_parts(profile: Profile) -> tuple[ConvexPart, ...]:
    """Divide a cutter into convex parts. The first part is the cutting part."""
    pieces = profile.pieces
    if profile.convex:
        arc = pieces[0]
        # a half circle from tip to top, up to rounding
        ball = len(pieces) == 1 and isinstance(arc, Arc) and arc.last - arc.first > pi - 1e-9
        return (ConvexPart(pieces, ball),)
    first = next(k for k, piece in enumerate(pieces) if piece.cutting)
    radius, height = pieces[first].at(np.zeros(1))[0][0].tolist()
    bottom = Line((0.0, height), (radius, height), False)
    lid = Line((radius, height), (0.0, height), False)
    return ConvexPart((bottom, *pieces[first:]), False), ConvexPart((*pieces[:first], lid), False)


def _seen(piece: Piece, points: Array) -> tuple[Array, Array]:
    """Return the distance [m] of points from a piece, and a signed component [m].

    The vector from the nearest point of the piece to the given point has a component along the
    outward normal. This component is positive outside the body.
    """
    if isinstance(piece, Arc):
        out = points - np.asarray(piece.centre)
        middle = 0.5 * (piece.first + piece.last)
        half = 0.5 * (piece.last - piece.first)
        turn = (np.arctan2(out[:, 1], out[:, 0]) - middle + pi) % (2.0 * pi) - pi
        angle = middle + np.clip(turn, -half, half)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        away = out - piece.radius * normal
        return np.hypot(away[:, 0], away[:, 1]), (away * normal).sum(axis=1)
    start = np.asarray(piece.start)
    end = np.asarray(piece.end)
    along = (end - start) / piece.length_m
    reach = np.clip((points - start) @ along, 0.0, piece.length_m)
    away = points - start - reach[:, None] * along
    return np.hypot(away[:, 0], away[:, 1]), away @ np.array([along[1], -along[0]])


def _to_segment(point: Array, start: Array, end: Array) -> Array:
    """Return the distance [m] of a point, shape (3,), from segments with ends of shape (n, 3)."""
    along = end - start
    # a segment without length is its start
    squared = np.maximum((along * along).sum(axis=1), 1e-300)
    share = np.clip(((point - start) * along).sum(axis=1) / squared, 0.0, 1.0)
    return np.linalg.norm(start + share[:, None] * along - point, axis=1)


@dataclass(frozen=True)
class ToolPath:
    """Poses and velocities of a tool at n ticks.

    Attributes
    ----------
    tips_m
        Positions of the tip [m], shape (n, 3).
    rotations
        Rotations from tool to world, shape (n, 3, 3).
    velocities
        Velocity of the tip [m/s], shape (n, 3).
    turnings
        Angular velocity of the tool [rad/s], shape (n, 3), without the spin about its axis.
    reach_m
        Largest distance of the tool's surface from its tip [m].
    legs
        First and last tick of each leg, shape (legs, 2). A leg is a part of the path that is a
        straight line, seen in the tool's frame, and does not reverse.
    """

    tips_m: Array
    rotations: Array
    velocities: Array
    turnings: Array
    reach_m: float
    legs: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "legs", self._found_legs())

    def in_tool(self, tick: int, points: Array) -> Array:
        """Convert points of the world [m], shape (n, 3), to the tool's frame at a tick."""
        return (points - self.tips_m[tick]) @ self.rotations[tick]

    def in_world(self, tick: int, points: Array) -> Array:
        """Convert points of the tool's frame [m], shape (n, 3), to the world at a tick."""
        return self.tips_m[tick] + points @ self.rotations[tick].T

    def swept_distance(
        self, tick: int, parts: tuple[ConvexPart, ...], points: Array, *, limit_m: Array
    ) -> Array:
        """Return the signed distance [m] from the volume that the tool has swept before a tick.

        The distance is negative inside this volume, and infinite if nothing was swept. The points,
        shape (n, 3), are in the world frame. For the leg that contains the tick, the first entry of
        `parts` is ignored. This is allowed because, on a straight path, advancing surface points of
        a convex body were never inside it before. A result that is larger than ``limit_m``, shape
        (n,) [m], is only a lower bound of the distance.
        """
        distance = np.full(len(points), np.inf)
        for start, end in self.legs[self.legs[:, 0] < tick]:
            present = bool(end >= tick)
            if present and len(parts) == 1:
                continue
            begins = self.in_tool(start, points)
            ends = self.in_tool(min(end, tick), points)
            for part in parts[1:] if present else parts:
                np.minimum(
                    distance, part.least_on_path(begins, ends, limit_m=limit_m), out=distance
                )
        return distance

    def _found_legs(self) -> NDArray[np.intp]:
        """Join successive ticks to straight legs, see `ToolPath.legs`."""
        last = len(self.tips_m) - 1
        legs: list[tuple[int, int]] = []
        start = 0
        while start < last:
            end = start + 1
            step = 1
            # the step doubles while the leg stays straight, then halves: few trials for long legs
            while step:
                if end + step <= last and self._is_straight(start, end + step):
                    end = end + step
                    step = 2 * step
                else:
                    step //= 2
            legs.append((start, end))
            start = end
        return np.array(legs, dtype=np.intp).reshape(-1, 2)

    def _is_straight(self, start: int, end: int) -> bool:
        """Return whether points near the tool move straight and without reversal between two ticks.

        The motion is observed in the tool's frame.
        """
        # the motion of all points is an affine combination of that of four points that are not in
        # one plane; the fifth is the tip
        corners = self.reach_m * np.array(
            [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1], [0, 0, 0]], dtype=float
        )
        world = np.concatenate([self.in_world(start, corners), self.in_world(end, corners)])
        ticks = slice(start, end + 1)
        seen = np.einsum(
            "tpc,tcd->tpd", world[None] - self.tips_m[ticks, None], self.rotations[ticks]
        )
        chord = seen[-1] - seen[0]
        length = np.linalg.norm(chord, axis=1)
        # a point at rest has no direction: its deviation is zero
        along = chord / np.maximum(length, 1e-300)[:, None]
        progress = np.einsum("tpc,pc->tp", seen - seen[0], along)
        off = seen - seen[0] - progress[..., None] * along
        onward = bool((np.diff(progress, axis=0) >= -STRAIGHT_M).all())
        return onward and bool(np.linalg.norm(off, axis=2).max() <= STRAIGHT_M)
