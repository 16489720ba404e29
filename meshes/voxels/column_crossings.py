"""Where vertical lines cross the triangles of a solid's surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ColumnCrossings", "column_crossings", "lowest_and_highest", "triangles_meeting"]

_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class ColumnCrossings:
    """Where vertical lines enter and leave the solid, sorted by line, then upward.

    Attributes
    ----------
    line
        Number of the line, shape (n,).
    height
        Height of the crossing [m], shape (n,).
    entering
        +1 where the line enters the solid, -1 where it leaves, shape (n,).
    """

    line: NDArray[np.int64]
    height: NDArray[np.float64]
    entering: NDArray[np.int64]


def column_crossings(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> ColumnCrossings:
    """Cross the vertical lines through each (x, y) with the triangles and keep where the winding number turns positive.

    An edge shared by two triangles is tested with the same arithmetic for both, so a line passes through one of them.

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


def triangles_meeting(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], axis: int, low: float, high: float
) -> NDArray[np.int64]:
    """Triangles whose box meets an interval along an axis."""
    below, above = vertices[:, axis] < low, vertices[:, axis] > high
    a, b, c = faces.T
    outside = (below[a] & below[b] & below[c]) | (above[a] & above[b] & above[c])
    return faces[~outside]


def _covered(
    corners: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First line and number of lines along x and y within each triangle's box, each shape (m, 2)."""
    boxes = [lowest_and_highest(*corners[:, :, k].T) for k in range(2)]
    first = [np.searchsorted(axis, low) for axis, (low, _) in zip((x, y), boxes, strict=True)]
    last = [np.searchsorted(axis, high, side="right") for axis, (_, high) in zip((x, y), boxes, strict=True)]
    return np.stack(first, axis=1), np.stack(last, axis=1) - np.stack(first, axis=1)


def lowest_and_highest(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest of three arrays, element by element; NumPy is slow along an axis of three."""
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _crossed(
    corners: NDArray[np.float64],
    faces: NDArray[np.int64],
    first: NDArray[np.int64],
    counts: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Line, height and sign (+1 entering) of each crossing of the triangles with the lines in their boxes."""
    pairs = counts[:, 0] * counts[:, 1]
    triangle = np.repeat(np.arange(len(pairs)), pairs)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    i = first[triangle, 0] + within // counts[triangle, 1]
    j = first[triangle, 1] + within % counts[triangle, 1]
    px, py = x[i], y[j]
    edge_normal = np.empty((3, len(triangle)))
    hit = np.ones(len(triangle), dtype=bool)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = np.sign(area).astype(np.int64)
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        backward = faces[:, one] > faces[:, two]
        start = np.where(backward[:, None], corners[:, two], corners[:, one])
        end = np.where(backward[:, None], corners[:, one], corners[:, two])
        step = end - start
        side = step[triangle, 0] * (py - start[triangle, 1]) - step[triangle, 1] * (px - start[triangle, 0])
        hit &= (side >= 0.0) == ((facing > 0) != backward)[triangle]
        edge_normal[k] = np.where(backward[triangle], -side, side)
    hit &= facing[triangle] != 0
    triangle, edge_normal = triangle[hit], edge_normal[:, hit]
    height = (edge_normal * corners[triangle, :, 2].T).sum(axis=0) / area[triangle]
    low, high = lowest_and_highest(*corners[triangle, :, 2].T)
    return i[hit] * len(y) + j[hit], np.clip(height, low, high), -facing[triangle]


def _turning(line: NDArray[np.int64], height: NDArray[np.float64], sign: NDArray[np.int64]) -> ColumnCrossings:
    """Keep the crossings where the winding number becomes positive or ceases to be."""
    if len(line) == 0:
        return ColumnCrossings(line, height, sign)
    order = np.lexsort((height, line))
    line, height, sign = line[order], height[order], sign[order]
    starts = np.concatenate([[True], line[1:] != line[:-1]])
    running = np.cumsum(sign)
    base = np.repeat((running - sign)[starts], np.diff(np.append(np.flatnonzero(starts), len(line))))
    after = running - base
    before = after - sign
    turns = (before > 0) != (after > 0)
    unclosed = line[np.append(starts[1:], True) & (after != 0)]
    turns &= ~np.isin(line, unclosed)
    return ColumnCrossings(line[turns], height[turns], np.where(after[turns] > 0, 1, -1))
