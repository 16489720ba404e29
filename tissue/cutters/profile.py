"""Profiles of cutters: half sections that are rotated around the tool's axis.

A profile runs in the (radius, height) half plane from the axis at the tip to the axis at the top,
with the material to its left. Heights are measured from the tip, the reference point of a tool
pose.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import cos, hypot, pi, radians, sin, tan

import numpy as np

from meshes.base.arrays import Array, Flags
from meshes.base.hints import suggests_arguments
from tissue.cutters.drill_point import DrillPoint

SMOOTH = 0.999
"""Cosine of the angle between normals above which an outline counts as smooth (judgement)."""
WEB = 0.18
"""Usual thickness of a twist drill's web, relative to its diameter; drills have 0.12 to 0.23."""
HELIX_RAD = radians(30.0)
"""Usual helix angle of a twist drill; surgical drills have 20 to 40 degrees."""
AXIS_M = 1e-9
"""Distance below which points count as lying on the axis [m]."""


@suggests_arguments
@dataclass(frozen=True)
class Line:
    """Straight piece from the point ``start`` to the point ``end``.

    Each point is a pair (radius, height) [m].

    ``cutting`` is True if the piece has cutting edges.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    cutting: bool = True

    @property
    def length_m(self) -> float:
        """Length [m]."""
        return hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])

    @property
    def area_m2(self) -> float:
        """Area swept around the axis [m2]."""
        return pi * (self.start[0] + self.end[0]) * self.length_m

    def at(self, share: Array) -> tuple[Array, Array]:
        """Return points (radius, height) [m] and outward unit normals, shape (n, 2) each.

        ``share`` contains the n positions along the piece, as fractions of its length.
        """
        a = np.asarray(self.start)
        b = np.asarray(self.end)
        direction = (b - a) / self.length_m
        return a + share[:, None] * (b - a), np.broadcast_to(
            [direction[1], -direction[0]], (len(share), 2)
        )

    def seen_from(self, points: Array) -> tuple[Array, Array]:
        """Return distances from this piece [m] and offset-curve curvatures [1/m], shape (n,) each.

        ``points`` contains (radius, height) [m], shape (n, 2).

        Each curvature is that of the piece's offset curve through the point.
        """
        a = np.asarray(self.start)
        b = np.asarray(self.end)
        share = np.clip((points - a) @ (b - a) / self.length_m**2, 0.0, 1.0)
        distance = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1)
        ends = (share == 0.0) | (share == 1.0)
        # Around an end, parallel curves are circles. 1e-12: a point may lie on an end.
        return distance, np.where(ends, 1.0 / np.maximum(distance, 1e-12), 0.0)

    def corners(self) -> list[tuple[float, float]]:
        """Return the start (radius, height) [m] of the piece, as the only corner.

        The end of the piece is left out, because it is the start of the next piece.
        """
        return [self.start]


@suggests_arguments
@dataclass(frozen=True)
class Arc:
    """Circular piece around ``centre`` from angle ``first`` to ``last`` [rad].

    At angle 0, the direction points away from the tool's axis. At -pi/2 it points down, like the
    direction from a ball's centre to the tip.
    """

    centre: tuple[float, float]
    radius: float
    first: float
    last: float
    cutting: bool = True

    @property
    def length_m(self) -> float:
        """Length [m]."""
        return self.radius * (self.last - self.first)

    @property
    def area_m2(self) -> float:
        """Area swept around the axis [m2]."""
        climb = self.radius * (sin(self.last) - sin(self.first))
        return 2.0 * pi * (self.centre[0] * self.length_m + self.radius * climb)

    def at(self, share: Array) -> tuple[Array, Array]:
        """Return points (radius, height) [m] and outward unit normals, shape (n, 2) each.

        ``share`` contains the n positions along the piece, as fractions of its length.
        """
        angle = self.first + share * (self.last - self.first)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(self.centre) + self.radius * normal, normal

    def seen_from(self, points: Array) -> tuple[Array, Array]:
        """Return distances from this arc [m] and offset-curve curvatures [1/m], shape (n,) each.

        ``points`` contains (radius, height) [m], shape (n, 2).

        Each curvature is that of the arc's offset curve through the point.
        """
        from_centre = points - np.asarray(self.centre)
        reach = np.linalg.norm(from_centre, axis=1)
        middle = 0.5 * (self.first + self.last)
        angle = np.arctan2(from_centre[:, 1], from_centre[:, 0])
        # The angle is wrapped to half a turn.
        off = np.abs(np.angle(np.exp(1j * (angle - middle))))
        within = off <= 0.5 * (self.last - self.first)
        ends = self.at(np.array([0.0, 1.0]))[0]
        to_ends = np.min(np.linalg.norm(points[:, None] - ends[None], axis=2), axis=1)
        distance = np.where(within, np.abs(reach - self.radius), to_ends)
        # 1e-12: a point may lie at the centre or on an end.
        return distance, 1.0 / np.maximum(np.where(within, reach, to_ends), 1e-12)

    def corners(self) -> list[tuple[float, float]]:
        """Return the corners (radius, height) [m] of a polygon along the arc.

        The end of the arc is left out, because it is the start of the next piece. The distance
        between polygon and arc is at most 1e-5 of the radius.
        """
        # The largest distance between a chord of 0.009 rad and the arc is 1e-5 of its radius.
        share = np.linspace(0.0, 1.0, max(int((self.last - self.first) / 0.009), 2), endpoint=False)
        return [(float(r), float(z)) for r, z in self.at(share)[0]]


Piece = Line | Arc


@suggests_arguments
@dataclass(frozen=True)
class Profile:
    """Half section of a body of revolution, from tip to top."""

    pieces: tuple[Piece, ...]
    convex: bool
    point: DrillPoint | None = None
    """Point of a twist drill with a chisel edge."""

    def __post_init__(self) -> None:
        # a tuple is hashable: a profile is the key of caches
        object.__setattr__(self, "pieces", tuple(self.pieces))

    @property
    def outline(self) -> Array:
        """Corner points, shape (n, 2): radius and height [m]."""
        points = [corner for piece in self.pieces for corner in piece.corners()]
        return np.array([*points, (0.0, float(self.pieces[-1].at(np.array([1.0]))[0][0, 1]))])

    @cached_property  # read in every tick of a cut
    def radius_m(self) -> float:
        """Largest radius [m]."""
        return float(self.outline[:, 0].max())

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Lowest and highest height above the tip [m]."""
        return float(self.outline[:, 1].min()), float(self.outline[:, 1].max())

    @property
    def edges(self) -> Array:
        """Points (radius, height) [m] at which the outline is not smooth, shape (n, 2).

        At the axis, the outline counts as smooth if it meets its mirror image without a corner.
        """
        ends = np.array([0.0, 1.0])
        starts = [piece.at(ends) for piece in self.pieces]
        found = []
        for before, after in pairwise(starts):
            if before[1][1] @ after[1][0] < SMOOTH:
                found.append(after[0][0])
        for at, normal in (
            (starts[0][0][0], starts[0][1][0]),
            (starts[-1][0][1], starts[-1][1][1]),
        ):
            if abs(normal[1]) < SMOOTH:
                found.append(at)
        return np.array(found).reshape(-1, 2)

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Return the signed distance from the outline [m], and the meridional curvature [1/m].

        The distance is negative inside. Both are evaluated at ``points``, which contains (radius,
        height) [m], shape (n, 2). Each curvature is that of the outline's offset curve through the
        point.
        """
        seen = [piece.seen_from(points) for piece in self.pieces]
        distances = np.stack([distance for distance, _ in seen])
        nearest = distances.argmin(axis=0)
        pick = (nearest, np.arange(len(points)))
        curvature = np.stack([bend for _, bend in seen])[pick]
        inside = _inside(self.outline, points)
        return np.where(inside, -distances[pick], distances[pick]), curvature


def _inside(outline: Array, points: Array) -> Flags:
    """Return True for each (radius, height) point that is inside a closed outline.

    The method counts the crossings of a ray in the direction of +radius.
    """
    inside = np.zeros(len(points), bool)
    for (r0, z0), (r1, z1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        # A horizontal edge is parallel to the ray and is skipped. No ray crosses the axis.
        if z0 == z1 or max(r0, r1) < AXIS_M:
            continue
        spans = (z0 > points[:, 1]) != (z1 > points[:, 1])
        crossing = r0 + (points[:, 1] - z0) * (r1 - r0) / (z1 - z0)
        inside ^= spans & (points[:, 0] < crossing)
    return inside


def ball_burr(*, diameter_m: float) -> Profile:
    """Return a ball burr with its tip at the lowest point of the ball."""
    r = 0.5 * diameter_m
    return Profile((Arc((0.0, r), r, -0.5 * pi, 0.5 * pi),), convex=True)


def cylinder(*, diameter_m: float, length_m: float) -> Profile:
    """Return a flat-ended cylinder (end mill) that cuts with its end and side."""
    r = 0.5 * diameter_m
    return Profile(
        (
            Line((0, 0), (r, 0)),
            Line((r, 0), (r, length_m)),
            Line((r, length_m), (0, length_m), False),
        ),
        True,
    )


def twist_drill(
    *,
    diameter_m: float,
    length_m: float,
    point_angle_rad: float,
    web_m: float | None = 0.0,
    helix_rad: float = HELIX_RAD,
) -> Profile:
    """Return a twist drill with conical lips and a cylindrical margin.

    ``point_angle_rad`` is the included angle of the lips. With a web, the drill has a chisel edge
    and its rake varies along the lips. If ``web_m`` is None, the web is `WEB` times the diameter.
    Without a web, the lips reach the axis and have a constant rake.
    """
    r = 0.5 * diameter_m
    web_m = WEB * diameter_m if web_m is None else web_m
    point = DrillPoint(r, web_m, helix_rad, point_angle_rad) if web_m > 0.0 else None
    chisel = 0.0 if point is None else point.chisel_radius_m
    shoulder = (r - chisel) / tan(0.5 * point_angle_rad)
    pieces = (
        Line((chisel, 0), (r, shoulder)),
        Line((r, shoulder), (r, length_m)),
        Line((r, length_m), (0, length_m), False),
    )
    tip = () if point is None else (Line((0, 0), (chisel, 0)),)
    return Profile((*tip, *pieces), convex=True, point=point)


def _peg(radius: float, length: float, top: float) -> list[Piece]:
    """Return a smooth guide peg from ``length`` below the tip up to the height ``top``.

    A peg with a radius of 0 has no pieces.
    """
    if radius == 0.0:
        return []
    return [
        Line((0, -length), (radius, -length), False),
        Line((radius, -length), (radius, top), False),
    ]


def hemispherical_reamer(
    *, diameter_m: float, peg_diameter_m: float = 0.0, peg_length_m: float = 0.0
) -> Profile:
    """Return a reamer shaped as half a ball, which cuts with its round face.

    The reamer has a central guide peg if the diameter of the peg is not 0.
    """
    r = 0.5 * diameter_m
    q = 0.5 * peg_diameter_m
    # With a peg, the cutting face begins where the ball is as wide as the peg.
    first = -0.5 * pi if q == 0.0 else -float(np.arccos(q / r))
    peg = _peg(q, peg_length_m, r + r * sin(first))
    face = Arc((0.0, r), r, first, 0.0)
    return Profile((*peg, face, Line((r, r), (0.0, r), False)), convex=q == 0.0)


def flat_reamer(
    *, diameter_m: float, length_m: float, peg_diameter_m: float = 0.0, peg_length_m: float = 0.0
) -> Profile:
    """Return a disc with the thickness ``length_m`` that cuts with its face and rim.

    The reamer has a central guide peg if the diameter of the peg is not 0.
    """
    r = 0.5 * diameter_m
    q = 0.5 * peg_diameter_m
    peg = _peg(q, peg_length_m, 0.0)
    face = Line((q, 0.0), (r, 0.0))
    rim = Line((r, 0.0), (r, length_m))
    return Profile((*peg, face, rim, Line((r, length_m), (0.0, length_m), False)), convex=q == 0.0)


def pear_bur(*, diameter_m: float, length_m: float) -> Profile:
    """Return a pear-shaped bur: a ball at the tip, and a taper to half the ball's diameter."""
    r = 0.5 * diameter_m
    slope = float(np.arctan2(0.5 * r, length_m - r))  # angle of the flank to the axis
    flank = Line((r * cos(slope), r + r * sin(slope)), (0.5 * r, length_m))
    return Profile(
        (
            Arc((0.0, r), r, -0.5 * pi, slope),
            flank,
            Line((0.5 * r, length_m), (0.0, length_m), False),
        ),
        True,
    )
