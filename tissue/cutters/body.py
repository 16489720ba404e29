"""Outline and medial axis of a whole tool, from which distances to structures are computed.

The medial axis consists of the centres of the largest inscribed balls. The union of these balls is
the tool.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import cos

import numpy as np

from meshes.base.arrays import Array, Int32s, Ints
from tissue.cutters.profile import Arc, Line, Piece, Profile

CONVEX = 1e-9
"""Sine of a right turn of an outline below which the turn counts as a rounding error."""


def outline_table(profile: Profile) -> dict[str, Array | Ints]:
    """Split a tool with `convex_parts`, and return the members of `kernels.tool_distance.Outline`.

    A guide peg and its cutter are separate parts.

    Returns
    -------
    kind
        0 for a line, 1 for an arc, shape (pieces,).
    shape
        Geometry of the pieces [m], shape (pieces, 10). Columns of a line: start point, unit
        direction, length, five zeros. Columns of an arc: centre, radius, unit direction to its
        middle, cosine of half its angle, unit directions to its ends.
    first
        Index of the first piece of each part, followed by the number of all pieces, shape (parts +
        1,).
    convex
        1 if a part is convex, shape (parts,).
    """
    parts = convex_parts(profile)
    pieces = [piece for part in parts for piece in part]
    return {
        "kind": np.array([isinstance(piece, Arc) for piece in pieces], np.int64),
        "shape": np.array([_row(piece) for piece in pieces]),
        "first": np.cumsum([0, *map(len, parts)]),
        "convex": np.array([_is_convex(part) for part in parts], np.int64),
    }


def _row(piece: Piece) -> list[float]:
    """Return one piece as a row of `shape`, see `outline_table`."""
    if isinstance(piece, Arc):
        half = 0.5 * (piece.last - piece.first)
        angles = np.array([piece.first + half, piece.first, piece.last])
        middle, start, end = np.column_stack([np.cos(angles), np.sin(angles)]).tolist()
        return [*piece.centre, piece.radius, *middle, cos(half), *start, *end]
    along = (np.asarray(piece.end) - piece.start) / piece.length_m
    return [*piece.start, *along.tolist(), piece.length_m, *([0.0] * 5)]


def convex_parts(profile: Profile) -> list[tuple[Piece, ...]]:
    """Split a tool at its guide peg, and return the outline of each part.

    The union of the parts is the tool, because the peg's part extends through the cutter up to the
    cutter's top. A tool without a peg is one part. The parts of all built-in cutters are convex.
    """
    pieces = profile.pieces
    first = next((k for k, piece in enumerate(pieces) if piece.cutting), 0)
    if profile.convex or first == 0:
        return [pieces]
    foot_radius, foot_height = pieces[first].at(np.zeros(1))[0][0].tolist()
    top = profile.height_range_m[1]
    bottom = Line((0.0, foot_height), (foot_radius, foot_height), False)
    shaft = Line((foot_radius, foot_height), (foot_radius, top), False)
    lid = Line((foot_radius, top), (0.0, top), False)
    return [(bottom, *pieces[first:]), (*pieces[:first], shaft, lid)]


def _is_convex(pieces: tuple[Piece, ...]) -> bool:
    """Return whether an outline only turns to the left."""
    ends = np.array([0.0, 1.0])
    normals = [piece.at(ends)[1] for piece in pieces]
    for before, after in pairwise(normals):
        a = before[1]
        b = after[0]
        if a[0] * b[1] - a[1] * b[0] < -CONVEX:
            return False
    starts_down = normals[0][0][1] <= CONVEX
    ends_up = normals[-1][1][1] >= -CONVEX
    return bool(starts_down and ends_up)


MEDIAL_TOLERANCE_M = 4e-6
"""Allowed error of the union of balls if polylines approximate the medial axis [m].

The error is the distance by which a ball of the true axis extends beyond this union.
"""
STRAIGHT_M = 1e-6
"""Largest deviation of the polylines from the true medial axis [m].

The deviation is measured in the space of radius, height and ball radius. Sampling and merging of
the polylines each add one such deviation. A ball extends beyond the union by at most twice their
sum, which is `MEDIAL_TOLERANCE_M`.
"""
FIRST_SAMPLES = 9
HALVINGS = 26
"""Largest number of halvings of the interval between two samples of a piece.

`FIRST_SAMPLES` is the number of initial samples of each piece.

The smallest intervals have 2e-9 of the length of a piece.
"""
BISECTIONS = 44
"""Number of bisection steps that find the radius of an inscribed ball.

In the largest tool, the remaining interval is 2e-14 m, far less than `TOUCH_M`.
"""
TOUCH_M = 1e-10
"""Distance by which a ball may extend beyond the outline because of rounding errors [m]."""


@dataclass(frozen=True, eq=False)
class MedialAxis:
    """Segments of the medial axis of a tool's half section.

    Attributes
    ----------
    starts_m, ends_m
        Distance from the tool's axis, height, and radius of the inscribed ball at the two ends of
        each segment [m], shape (segments, 3). The ball radius is linear along a segment.
    across
        1 if a ball of the segment extends beyond every single part of `convex_parts`, else 0; shape
        (segments,). Such segments occur where a peg joins the cutter.
    """

    starts_m: Array
    ends_m: Array
    across: Int32s


def medial_axis(profile: Profile, *, straight_m: float = STRAIGHT_M) -> MedialAxis:
    """Compute the medial axis of a half section.

    The axis is approximated by polylines that deviate from it by at most `straight_m` [m], see
    `STRAIGHT_M`. The medial axis consists of the centres of the largest inscribed balls, which
    touch the outline. For each sample point of the outline, a bisection finds the largest inscribed
    ball that touches this point.
    """
    chains = [_chain(profile, touch, straight_m) for touch in _touches(profile.pieces)]
    starts = np.concatenate([chain[:-1] for chain in chains])
    ends = np.concatenate([chain[1:] for chain in chains])
    parts = [Profile(part, True) for part in convex_parts(profile)]
    middles = 0.5 * (starts + ends)
    across = np.zeros(len(starts), np.int32)
    if len(parts) > 1:
        for balls in (starts, middles, ends):
            # The balls of a polyline deviate by up to `straight_m`.
            held = np.max([-part.distance(balls[:, :2])[0] for part in parts], axis=0)
            across |= (held < balls[:, 2] - straight_m).astype(np.int32)
    return MedialAxis(starts, ends, across)


Touch = Callable[[Array], tuple[Array, Array]]
"""Map from numbers in [0, 1] to outline points [m] and outward normals, each of shape (n, 2)."""


def _touches(pieces: tuple[Piece, ...]) -> list[Touch]:
    """Return a map for each piece and each reentrant corner that an inscribed ball can touch.

    A reentrant corner points into the tool.
    """
    touches: list[Touch] = [piece.at for piece in pieces]
    ends = np.array([0.0, 1.0])
    for before, after in pairwise(pieces):
        corner = after.at(ends)[0][0]
        first = before.at(ends)[1][1]
        last = after.at(ends)[1][0]
        turn = float(np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last))
        # The outline turns to the right: the corner points into the tool.
        if turn < 0.0:
            touches.append(_fan(corner, float(np.arctan2(first[1], first[0])), turn))
    return touches


def _fan(corner: Array, first: float, turn: float) -> Touch:
    """Return the map for a corner, with normals between the normals of the adjacent pieces."""

    def touch(share: Array) -> tuple[Array, Array]:
        angle = first + share * turn
        return np.broadcast_to(corner, (len(share), 2)), np.column_stack(
            [np.cos(angle), np.sin(angle)]
        )

    return touch


def _chain(profile: Profile, touch: Touch, straight_m: float) -> Array:
    """Return the polyline of ball centres and radii along one piece, shape (n, 3)."""
    share = np.linspace(0.0, 1.0, FIRST_SAMPLES)
    balls = _balls(profile, *touch(share))
    is_open = np.ones(len(share) - 1, bool)
    for _ in range(HALVINGS):
        (where,) = np.nonzero(is_open)
        if not len(where):
            break
        middle = 0.5 * (share[where] + share[where + 1])
        between = _balls(profile, *touch(middle))
        bent = _deviation(between, balls[where], balls[where + 1]) > straight_m
        is_open[where] = bent
        share = np.insert(share, where + 1, middle)
        balls = np.insert(balls, where + 1, between, axis=0)
        is_open = np.insert(is_open, where + 1, bent)
    return balls[_merged(balls, straight_m)]


def _balls(profile: Profile, points: Array, normals: Array) -> Array:
    """Return the largest inscribed balls that touch given points of the outline, shape (n, 3).

    The columns are radius and height of the centre, and the ball radius.
    """
    low, high = profile.height_range_m
    least = np.zeros(len(points))
    # Upper bound: no ball inside the tool is larger.
    most = np.full(len(points), 0.5 * (high - low) + profile.radius_m)
    for _ in range(BISECTIONS):
        size = 0.5 * (least + most)
        centres = points - size[:, None] * normals
        # A centre outside the tool is closer to the point where the normal crosses the outline, so
        # no sign is needed. Beyond the axis, a ball is closer to the other side of the outline.
        nearest = np.min([piece.seen_from(centres)[0] for piece in profile.pieces], axis=0)
        fits = (centres[:, 0] >= -TOUCH_M) & (nearest >= size - TOUCH_M)
        least = np.where(fits, size, least)
        most = np.where(fits, most, size)
    centres = points - least[:, None] * normals
    # The centre of a ball on the axis may lie beyond the axis by TOUCH_M.
    centres[:, 0] = np.maximum(centres[:, 0], 0.0)
    return np.column_stack([centres, least])


def _deviation(balls: Array, starts: Array, ends: Array) -> Array:
    """Return the distances of balls from segments [m].

    Distances are in the space of radius, height and ball radius.
    """
    along = ends - starts
    # 1e-30: the two ends of a segment may coincide.
    squared = np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    share = np.clip(np.einsum("ij,ij->i", balls - starts, along) / squared, 0.0, 1.0)
    return np.linalg.norm(balls - starts - share[:, None] * along, axis=1)


def _merged(balls: Array, straight_m: float) -> Ints:
    """Return the indices of the samples that represent a polyline (Douglas and Peucker 1973)."""
    kept = {0, len(balls) - 1}
    spans = [(0, len(balls) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = balls[first + 1 : last]
        deviation = _deviation(inner, balls[first : first + 1], balls[last : last + 1])
        if deviation.max() > straight_m:
            split = first + 1 + int(deviation.argmax())
            kept.add(split)
            spans += [(first, split), (split, last)]
    return np.array(sorted(kept))
