"""Bone fraction and depth of voxels under a triangle surface.

Fraction: each voxel column holds 3 x 3 lines along z; where a line crosses the triangles its winding number changes,
and the lengths with a positive winding number are the bone in it. Exact along z, a quadrature of nine lines across.
Depth: the distance to the surface on a lattice of 0.4 mm or a voxel, interpolated to the voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.grid import Grid

__all__ = ["ColumnCrossings", "TriangleSampler", "column_crossings", "triangle_distance"]

_LINES = 3
_PAIRS_AT_ONCE = 2_000_000
_WIDEST_LATTICE_M = 0.41e-3
_CELLS_BEYOND = 4
_OFFSET = np.array([0.0137, 0.0071])


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


@dataclass(frozen=True, eq=False)
class TriangleSampler:
    """Fraction and depth of the voxels of a grid under a closed surface.

    Attributes
    ----------
    vertices_m
        Vertices in the frame of the grid [m], shape (n, 3).
    faces
        Triangles wound outward, shape (m, 3).
    exact_m
        Depth up to which it has to be right; farther in it is only not less than that. Triangles farther away than that
        are left out.
    """

    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int64]
    exact_m: float = np.inf

    @cached_property
    def _box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner of each triangle [m], shape (m, 3)."""
        corners = self.vertices_m[self.faces]
        return corners.min(axis=1), corners.max(axis=1)

    def _within(self, grid: Grid, margin: float, axes: int) -> NDArray[np.int64]:
        """Triangles whose box meets that of the grid, grown by a margin [m], along its first `axes` axes."""
        low, high = self._box
        first, last = (np.array(corner) * grid.spacing_m for corner in (grid.first, grid.last))
        near = np.ones(len(self.faces), dtype=bool)
        for axis in range(axes):
            near &= (low[:, axis] <= last[axis] + margin) & (high[:, axis] >= first[axis] - margin)
        return self.faces[near]

    def __call__(self, grid: Grid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Fraction 0 to 1 and depth [m], positive inside, float32, shape of the blocked grid.

        The depth is found only in lattice cells with bone in them; elsewhere it means nothing.
        """
        fraction = self._fraction(grid)
        return fraction, self._depth(grid, fraction)

    def _fraction(self, grid: Grid) -> NDArray[np.float32]:
        nx, ny, nz = grid.shape
        pitch = grid.spacing_m / _LINES
        x = ((np.arange(nx * _LINES) + grid.first[0] * _LINES + 0.5) + _OFFSET[0]) * pitch
        y = ((np.arange(ny * _LINES) + grid.first[1] * _LINES + 0.5) + _OFFSET[1]) * pitch
        crossings = column_crossings(self.vertices_m, self._within(grid, grid.spacing_m, 2), x, y)
        level = np.clip(crossings.height / grid.spacing_m - grid.first[2], 0.0, nz)
        voxel = np.minimum(level.astype(np.int64), nz - 1)
        row, column = crossings.line // len(y) // _LINES, crossings.line % len(y) // _LINES
        flat = (row * ny + column) * (nz + 1) + voxel
        size = nx * ny * (nz + 1)
        covered = crossings.entering * (voxel + 1 - level)
        change = np.bincount(flat, weights=covered, minlength=size)
        change += np.bincount(flat + 1, weights=crossings.entering - covered, minlength=size)
        filled = np.cumsum(change.reshape(nx, ny, nz + 1), axis=2)[:, :, :nz] / _LINES**2
        return np.clip(filled, 0.0, 1.0).astype(np.float32)

    def _depth_at(self, grid: Grid, points: NDArray[Any]) -> NDArray[np.float64]:
        """Depth of points [m] in cells with bone in them."""
        if np.isinf(self.exact_m):
            return -triangle_distance(self.vertices_m, self.faces, points)
        margin = self.exact_m + _CELLS_BEYOND * max(_WIDEST_LATTICE_M, grid.spacing_m)
        near = self._within(grid, margin, 3)
        if len(near) == 0:
            return np.full(len(points), margin)
        vertices, faces = _used(self.vertices_m, near)
        enough = self.exact_m + 2.0 * max(_WIDEST_LATTICE_M, grid.spacing_m)
        depth = _kept_away(vertices, faces, points, enough)
        close = depth < enough
        depth[close] = -triangle_distance(vertices, faces, points[close])
        # So far from all that was kept, a point of a cell with bone lies inside, whatever side the nearest would say.
        return np.where(np.abs(depth) >= margin, np.abs(depth), depth)

    def _depth(self, grid: Grid, fraction: NDArray[np.float32]) -> NDArray[np.float32]:
        step = next((n for n in (8, 4, 2) if n * grid.spacing_m <= _WIDEST_LATTICE_M), 1)
        bx, by, bz = (n // step for n in grid.shape)
        occupied = fraction.reshape(bx, step, by, step, bz, step).max(axis=(1, 3, 5)) > 0.0
        needed = np.zeros((bx + 1, by + 1, bz + 1), dtype=bool)
        for i, j, k in np.ndindex(2, 2, 2):
            needed[i : bx + i, j : by + j, k : bz + k] |= occupied
        lattice = (np.argwhere(needed) * step + grid.first) * grid.spacing_m
        corners = np.zeros(needed.shape, dtype=np.float32)
        corners[needed] = self._depth_at(grid, lattice)
        weight = ((np.arange(step) + 0.5) / step).astype(np.float32)
        for axis in range(3):
            low, high = np.delete(corners, -1, axis=axis), np.delete(corners, 0, axis=axis)
            shape = list(low.shape)
            shape[axis] *= step
            along = weight.reshape([-1 if k == axis + 1 else 1 for k in range(4)])
            low, high = np.expand_dims(low, axis + 1), np.expand_dims(high, axis + 1)
            corners = (low + (high - low) * along).reshape(shape)
        return corners


def _kept_away(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], points: NDArray[Any], enough: float
) -> NDArray[np.float64]:
    """Distance [m] that points, shape (n, 3), keep at least from the triangles, as far as `enough`."""
    from scipy.spatial import cKDTree

    corners = vertices[faces]
    longest = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max())
    to_vertex, _ = cKDTree(vertices).query(points, distance_upper_bound=enough + longest)
    return np.where(np.isinf(to_vertex), enough, to_vertex - longest)


def _used(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangles with the vertices that they use and no others."""
    named = np.zeros(len(vertices), dtype=bool)
    named[faces] = True
    return vertices[named], (np.cumsum(named) - 1)[faces]


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
        Positions of the lines [m], evenly spaced, ascending; line i·len(y) + j stands at (x[i], y[j]).
    """
    lines, heights, signs = [], [], []
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
        line, height, sign = _crossed(corners[chosen], faces[chosen], first[chosen], counts[chosen], x, y)
        lines.append(line)
        heights.append(height)
        signs.append(sign)
        start = stop
    if not lines:
        empty = np.empty(0, dtype=np.int64)
        return ColumnCrossings(empty, np.empty(0), empty)
    return _turning(np.concatenate(lines), np.concatenate(heights), np.concatenate(signs))


def triangle_distance(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], points: NDArray[Any]
) -> NDArray[np.float64]:
    """Signed distance [m] of points [m], shape (n, 3), from the surface, negative inside, shape (n,)."""
    import pyvista

    if len(points) == 0:
        return np.empty(0)
    surface = pyvista.PolyData.from_regular_faces(vertices, faces.astype(int))
    cloud = pyvista.PolyData(np.ascontiguousarray(points, dtype=np.float64))
    found = cloud.compute_implicit_distance(surface)
    return np.asarray(found["implicit_distance"], dtype=np.float64)


def _covered(
    corners: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First line and number of lines along x and y within each triangle's box, each shape (m, 2)."""
    first = np.stack([np.searchsorted(axis, corners[:, :, k].min(axis=1)) for k, axis in enumerate((x, y))], axis=1)
    last = np.stack(
        [np.searchsorted(axis, corners[:, :, k].max(axis=1), side="right") for k, axis in enumerate((x, y))], axis=1
    )
    return first, last - first


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
    low, high = corners[triangle, :, 2].min(axis=1), corners[triangle, :, 2].max(axis=1)
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
    ends = np.append(starts[1:], True)
    unclosed = np.isin(line, line[ends & (after != 0)])
    turns &= ~unclosed
    return ColumnCrossings(line[turns], height[turns], np.where(after[turns] > 0, 1, -1))
