"""Crossings of vertical lines with the triangles of a solid's surface."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints

__all__ = [
    "ColumnCrossings",
    "column_crossings",
    "inside_scattered",
    "lowest_and_highest",
    "triangles_meeting",
]

_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class ColumnCrossings:
    """Heights at which vertical lines enter and leave the solid, sorted by line, then upward.

    Attributes
    ----------
    line
        Number of the line, shape (n,).
    height
        Height of the crossing [m], shape (n,).
    entering
        +1 where the line enters the solid, -1 where it leaves, shape (n,).
    """

    line: Ints
    height: Array
    entering: Ints


def column_crossings(vertices: Array, faces: Ints, x: Array, y: Array) -> ColumnCrossings:
    """Cross the vertical lines through each (x, y) with the triangles.

    Crossings where the winding number starts or ceases to be positive are kept.

    An edge shared by two triangles is tested with the same arithmetic for both, so a line passes
    through one of them.

    Parameters
    ----------
    vertices, faces
        Triangles wound outward, [m], shapes (n, 3) and (m, 3).
    x, y
        Positions of the lines [m], evenly spaced, ascending; line i·len(y) + j is at (x[i], y[j]).
    """
    found = []
    for axis, at in enumerate((x, y) if len(x) and len(y) else ()):
        faces = triangles_meeting(vertices, faces, axis, at[0], at[-1])
    corners = vertices[faces]
    first, counts = _covered(corners, x, y)
    pairs = counts[:, 0] * counts[:, 1]
    kept = np.flatnonzero(pairs)
    ends = np.cumsum(pairs[kept])
    start = 0
    while start < len(kept):
        begun = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, begun + _PAIRS_AT_ONCE)), start + 1)
        chosen = kept[start:stop]
        found.append(_crossed(corners[chosen], faces[chosen], first[chosen], counts[chosen], x, y))
        start = stop
    if not found:
        empty = np.empty(0, dtype=np.int64)
        return ColumnCrossings(empty, np.empty(0), empty)
    lines, heights, signs = zip(*found, strict=True)
    return _turning(np.concatenate(lines), np.concatenate(heights), np.concatenate(signs))


def inside_scattered(vertices: Array, faces: Ints, points: Floats) -> Flags:
    """Return whether points [m], shape (n, 3), lie where the winding number is positive.

    Each point is tested by the vertical line through it. Triangles are sorted into square columns,
    so that a point is tested only against the triangles of its column.
    """
    points = np.asarray(points, dtype=np.float64)
    inside = np.zeros(len(points), dtype=bool)
    for axis in range(2 if len(points) else 0):
        faces = triangles_meeting(
            vertices, faces, axis, points[:, axis].min(), points[:, axis].max()
        )
    if len(points) == 0 or len(faces) == 0:
        return inside
    corners = vertices[faces]
    low = points[:, :2].min(axis=0)
    count = max(int(len(faces) ** 0.5), 1)
    edge = np.maximum(np.ptp(points[:, :2], axis=0), 1e-9) / count
    triangle, starts = _by_column(corners, low, edge, count)
    at = np.clip(np.floor((points[:, :2] - low) / edge), 0, count - 1).astype(np.int64) @ np.array(
        [count, 1]
    )
    pairs = starts[at + 1] - starts[at]
    ends = np.cumsum(pairs)
    done = 0
    while done < len(points):
        stop = max(
            int(np.searchsorted(ends, (ends[done - 1] if done else 0) + _PAIRS_AT_ONCE)), done + 1
        )
        part = np.arange(done, stop)
        many = pairs[done:stop]
        point = np.repeat(part, many)
        nth = np.arange(len(point)) - np.repeat(np.cumsum(many) - many, many)
        tested = triangle[starts[at[point]] + nth]
        met, height, sign = _met(corners, faces, tested, points[point, 0], points[point, 1])
        point = point[met]
        below = sign * (height <= points[point, 2])
        winding = np.bincount(point - done, weights=below, minlength=len(part))
        unclosed = np.bincount(point - done, weights=sign, minlength=len(part)) != 0.0
        inside[part] = (winding > 0.5) & ~unclosed
        done = stop
    return inside


def _by_column(corners: Array, low: Array, edge: Array, count: int) -> tuple[Ints, Ints]:
    """Return triangles whose box overlaps each of count x count columns, column after column.

    Also return the start of each column.
    """
    boxes = np.stack([corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)])
    first, last = np.clip(np.floor((boxes - low) / edge), 0, count - 1).astype(np.int64)
    wide = last - first + 1
    columns = wide.prod(axis=1)
    triangle = np.repeat(np.arange(len(corners)), columns)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(columns) - columns, columns)
    x = first[triangle, 0] + within // wide[triangle, 1]
    y = first[triangle, 1] + within % wide[triangle, 1]
    column = x * count + y
    order = np.argsort(column, kind="stable")
    return triangle[order], np.searchsorted(column[order], np.arange(count**2 + 1))


def triangles_meeting(vertices: Array, faces: Ints, axis: int, low: float, high: float) -> Ints:
    """Return triangles whose box overlaps an interval along an axis."""
    below = vertices[:, axis] < low
    above = vertices[:, axis] > high
    a, b, c = faces.T
    outside = (below[a] & below[b] & below[c]) | (above[a] & above[b] & above[c])
    return faces[~outside]


def _covered(corners: Array, x: Array, y: Array) -> tuple[Ints, Ints]:
    """Return first line and number of lines along x and y within each triangle's box.

    Each has the shape (m, 2).
    """
    boxes = [lowest_and_highest(*corners[:, :, k].T) for k in range(2)]
    first = [np.searchsorted(axis, low) for axis, (low, _) in zip((x, y), boxes, strict=True)]
    last = [
        np.searchsorted(axis, high, side="right")
        for axis, (_, high) in zip((x, y), boxes, strict=True)
    ]
    return np.stack(first, axis=1), np.stack(last, axis=1) - np.stack(first, axis=1)


def lowest_and_highest(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Return lowest and highest of three arrays, element by element.

    NumPy is slow along an axis of three.
    """
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _crossed(
    corners: Array,
    faces: Ints,
    first: Ints,
    counts: Ints,
    x: Array,
    y: Array,
) -> tuple[Ints, Array, Ints]:
    """Return line, height and sign (+1 entering) of each crossing of triangles and lines.

    Only the lines in a triangle's box are tested.
    """
    pairs = counts[:, 0] * counts[:, 1]
    triangle = np.repeat(np.arange(len(pairs)), pairs)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    i = first[triangle, 0] + within // counts[triangle, 1]
    j = first[triangle, 1] + within % counts[triangle, 1]
    kept, height, sign = _met(corners, faces, triangle, x[i], y[j])
    return i[kept] * len(y) + j[kept], height, sign


def _met(
    corners: Array,
    faces: Ints,
    triangle: Ints,
    px: Array,
    py: Array,
) -> tuple[Flags, Array, Ints]:
    """Return flags of the vertical lines through (px, py) that cross their triangle.

    Also return height and sign (+1 entering) of the crossings.
    """
    edge_normal = np.empty((3, len(triangle)))
    hit = np.ones(len(triangle), dtype=bool)
    a = corners[:, 0]
    b = corners[:, 1]
    c = corners[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = np.sign(area).astype(np.int64)
    for k in range(3):
        one = (k + 1) % 3
        two = (k + 2) % 3
        backward = faces[:, one] > faces[:, two]
        start = np.where(backward[:, None], corners[:, two], corners[:, one])
        end = np.where(backward[:, None], corners[:, one], corners[:, two])
        step = end - start
        side = step[triangle, 0] * (py - start[triangle, 1]) - step[triangle, 1] * (
            px - start[triangle, 0]
        )
        hit &= (side >= 0.0) == ((facing > 0) != backward)[triangle]
        edge_normal[k] = np.where(backward[triangle], -side, side)
    hit &= facing[triangle] != 0
    triangle = triangle[hit]
    edge_normal = edge_normal[:, hit]
    height = (edge_normal * corners[triangle, :, 2].T).sum(axis=0) / area[triangle]
    low, high = lowest_and_highest(*corners[triangle, :, 2].T)
    return hit, np.clip(height, low, high), -facing[triangle]


def _turning(line: Ints, height: Array, sign: Ints) -> ColumnCrossings:
    """Keep the crossings where the winding number becomes positive or ceases to be."""
    if len(line) == 0:
        return ColumnCrossings(line, height, sign)
    order = np.lexsort((height, line))
    line = line[order]
    height = height[order]
    sign = sign[order]
    starts = np.concatenate([[True], line[1:] != line[:-1]])
    running = np.cumsum(sign)
    base = np.repeat(
        (running - sign)[starts], np.diff(np.append(np.flatnonzero(starts), len(line)))
    )
    after = running - base
    before = after - sign
    turns = (before > 0) != (after > 0)
    unclosed = line[np.append(starts[1:], True) & (after != 0)]
    turns &= ~np.isin(line, unclosed)
    return ColumnCrossings(line[turns], height[turns], np.where(after[turns] > 0, 1, -1))
