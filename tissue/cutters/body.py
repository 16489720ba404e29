"""Whole body of a tool, including pegs and inside, used to measure distances to structures."""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, cos, pi

import numpy as np

from meshes.base.arrays import Array, Int32s, lattice
from tissue.cutters.cutter import spiral
from tissue.cutters.profile import Arc, Line, Piece, Profile

__all__ = ["OutlineTable", "body_points", "convex_parts", "outline_table"]

ON_SURFACE = 3000
INSIDE = 1000
"""Approximate largest number of points on the surface and inside."""
CONVEX = 1e-9


def body_points(profile: Profile, *, spacing_m: float) -> Array:
    """Return points of a body of revolution for pictures and bounding boxes [m], shape (n, 3).

    The origin is at the tip. The points cover the cutting and the smooth surface up to the top of
    the profile, every ring at which the outline bends, and the inside on a lattice. They are
    `spacing_m` [m] apart on the surface, or farther apart to limit their number.
    """
    spacing = max(spacing_m, (sum(piece.area_m2 for piece in profile.pieces) / ON_SURFACE) ** 0.5)
    parts = [spiral(piece, spacing_m=spacing)[0] for piece in profile.pieces]
    for radius, height in [
        *profile.edges.tolist(),
        *((0.0, height) for height in profile.height_range_m),
    ]:
        parts.append(_ring(radius, height, max(ceil(2.0 * pi * radius / spacing), 1)))
    return np.concatenate([*parts, _inside(profile, spacing)])


def _ring(radius: float, height: float, count: int) -> Array:
    """Return evenly spaced points on a circle around the axis."""
    turn = np.arange(count) * (2.0 * pi / count)
    circle = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.column_stack([circle, np.full(count, height)])


def _inside(profile: Profile, spacing: float) -> Array:
    """Return points of a cubic lattice inside a profile, deeper than half their spacing."""
    reach = profile.radius_m
    (low, high) = profile.height_range_m
    pitch = max(2.0 * spacing, (pi * reach**2 * (high - low) / INSIDE) ** (1.0 / 3.0))
    across = pitch * np.arange(-ceil(reach / pitch), ceil(reach / pitch) + 1)
    grid = lattice(across, across, np.arange(low, high, pitch))
    half = np.column_stack([np.hypot(grid[:, 0], grid[:, 1]), grid[:, 2]])
    return np.asarray(grid[profile.distance(half)[0] < -0.5 * pitch])


@dataclass(frozen=True, eq=False)
class OutlineTable:
    """Half sections of the convex parts of a tool as arrays, for `kernels.tool_distance.Outline`.

    Attributes
    ----------
    kind
        0 for a line, 1 for an arc, shape (pieces,).
    shape
        Geometry of the pieces, shape (pieces, 10), [m]. Line: start, unit direction, length. Arc:
        centre, radius, direction of its middle, cosine of its half angle, directions of its ends.
    first
        First piece of each part, and the number of pieces, shape (parts + 1,).
    convex
        1 where a part is convex, shape (parts,).
    """

    kind: Int32s
    shape: Array
    first: Int32s
    convex: Int32s


def outline_table(profile: Profile) -> OutlineTable:
    """Split a tool into convex parts and return their outlines as arrays.

    A peg is separate from the cutter that it guides.
    """
    parts = convex_parts(profile)
    rows = [_row(piece) for part in parts for piece in part]
    first = np.cumsum([0, *map(len, parts)])
    convex = [_is_convex(part) for part in parts]
    kinds = [isinstance(piece, Arc) for part in parts for piece in part]
    return OutlineTable(
        np.array(kinds, np.int32),
        np.array(rows),
        first.astype(np.int32),
        np.array(convex, np.int32),
    )


def _row(piece: Piece) -> list[float]:
    """Return one piece as ten numbers."""
    if isinstance(piece, Arc):
        half = 0.5 * (piece.last - piece.first)
        angles = np.array([piece.first + half, piece.first, piece.last])
        middle, start, end = np.column_stack([np.cos(angles), np.sin(angles)]).tolist()
        return [*piece.centre, piece.radius, *middle, cos(half), *start, *end]
    along = (np.asarray(piece.end) - piece.start) / piece.length_m
    return [*piece.start, *along.tolist(), piece.length_m, *([0.0] * 5)]


def convex_parts(profile: Profile) -> list[tuple[Piece, ...]]:
    """Split a tool into convex outlines whose union is the tool.

    A peg extends through the tool to its top.
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
    """Return whether an outline turns only to its left."""
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
