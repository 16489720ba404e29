"""Bone fraction and depth of voxels inside a closed triangle surface.

The bone fraction is computed from 3 x 3 lines along z in each voxel column. The winding number
along a line changes where the line crosses triangles, and the parts of a line with a positive
winding number are bone. The integral of the fraction along z is therefore exact. In the x-y plane,
the integral is approximated by nine lines. The depth is the distance from the surface. It is
computed on a lattice with a spacing of 0.4 mm or one voxel, and interpolated to the voxels.

The same crossings determine whether scattered points lie inside a surface.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints, Singles, compact
from meshes.base.grid import Grid

_PAIRS_AT_ONCE = 2_000_000
"""Number of pairs (triangle, line) that are tested at once, in a dozen arrays of 16 MB."""


@dataclass(frozen=True, eq=False)
class ColumnCrossings:
    """Crossings of vertical lines and a solid's surface, sorted by line and then by height.

    Attributes
    ----------
    line
        Index of the line, shape (n,).
    height
        Height of the crossing [m], shape (n,).
    entering
        +1 if the line enters the solid, -1 if it leaves the solid, shape (n,).
    """

    line: Ints
    height: Array
    entering: Ints


def column_crossings(vertices: Array, faces: Ints, x: Array, y: Array) -> ColumnCrossings:
    """Compute the crossings of a solid's surface and the vertical line through each (x, y).

    The returned crossings are those at which the winding number becomes positive or stops being
    positive.

    The test whether a line passes an edge uses the same arithmetic for both triangles at the edge.
    A line near the edge therefore crosses exactly one of the two triangles.

    Parameters
    ----------
    vertices, faces
        Vertices [m], shape (n, 3), and triangles with outward normals, shape (m, 3).
    x, y
        Positions of the lines [m], each array evenly spaced and ascending. Line i·len(y) + j is at
        (x[i], y[j]).
    """
    found = []
    for axis, at in enumerate((x, y) if len(x) and len(y) else ()):
        faces = triangles_meeting(vertices, faces, axis, at[0], at[-1])
    corners = vertices[faces]
    first, counts = _covered(corners, x, y)
    pairs = counts[:, 0] * counts[:, 1]
    kept = np.flatnonzero(pairs)
    for part in _batches(pairs[kept]):
        chosen = kept[part]
        found.append(_crossed(corners[chosen], faces[chosen], first[chosen], counts[chosen], x, y))
    if not found:
        empty = np.empty(0, dtype=np.int64)
        return ColumnCrossings(empty, np.empty(0), empty)
    lines, heights, signs = zip(*found, strict=True)
    return _turning(np.concatenate(lines), np.concatenate(heights), np.concatenate(signs))


def inside_scattered(vertices: Array, faces: Ints, points: Floats) -> Flags:
    """Return whether the winding number is positive at each of the points [m], shape (n, 3).

    The test of a point uses the vertical line through the point. Triangles are sorted into square
    columns, so a point is only tested against the triangles of its column.
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
    # The number of columns is about the number of triangles, so a column contains few triangles.
    count = max(int(len(faces) ** 0.5), 1)
    edge = np.maximum(np.ptp(points[:, :2], axis=0), 1e-9) / count
    triangle, starts = _by_column(corners, low, edge, count)
    at = np.clip(np.floor((points[:, :2] - low) / edge), 0, count - 1).astype(np.int64) @ np.array(
        [count, 1]
    )
    pairs = starts[at + 1] - starts[at]
    for part in _batches(pairs):
        owner, nth = _repeated(pairs[part])
        point = owner + part.start
        tested = triangle[starts[at[point]] + nth]
        crossed, height, sign = _crossings(
            corners, faces, tested, points[point, 0], points[point, 1]
        )
        owner = owner[crossed]
        below = sign * (height <= points[point[crossed], 2])
        tried = part.stop - part.start
        winding = np.bincount(owner, weights=below, minlength=tried)
        unclosed = np.bincount(owner, weights=sign, minlength=tried) != 0.0
        # Winding numbers are integers. On a line through a hole of the surface, the winding number
        # does not end at 0, so inside and outside are unknown.
        inside[part] = (winding > 0.5) & ~unclosed
    return inside


def _batches(pairs: Ints) -> Iterator[slice]:
    """Yield slices of consecutive entries such that each slice has about `_PAIRS_AT_ONCE` pairs.

    `pairs` contains the number of pairs of each entry.
    """
    ends = np.cumsum(pairs)
    start = 0
    while start < len(pairs):
        begun = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, begun + _PAIRS_AT_ONCE)), start + 1)
        yield slice(start, stop)
        start = stop


def _repeated(counts: Ints) -> tuple[Ints, Ints]:
    """Repeat each index k `counts[k]` times, and number the repetitions of each index from 0."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _by_column(corners: Array, low: Array, edge: Array, count: int) -> tuple[Ints, Ints]:
    """Return the triangles whose bounding box overlaps each of count x count columns.

    The triangles are sorted by column. Also return the index at which each column starts.
    """
    boxes = np.stack([corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)])
    first, last = np.clip(np.floor((boxes - low) / edge), 0, count - 1).astype(np.int64)
    wide = last - first + 1
    triangle, within = _repeated(wide.prod(axis=1))
    x = first[triangle, 0] + within // wide[triangle, 1]
    y = first[triangle, 1] + within % wide[triangle, 1]
    column = x * count + y
    order = np.argsort(column, kind="stable")
    return triangle[order], np.searchsorted(column[order], np.arange(count**2 + 1))


def triangles_meeting(vertices: Array, faces: Ints, axis: int, low: float, high: float) -> Ints:
    """Return the triangles whose bounding box overlaps an interval along an axis."""
    below = vertices[:, axis] < low
    above = vertices[:, axis] > high
    a, b, c = faces.T
    outside = (below[a] & below[b] & below[c]) | (above[a] & above[b] & above[c])
    return faces[~outside]


def _covered(corners: Array, x: Array, y: Array) -> tuple[Ints, Ints]:
    """Return the first line and the number of lines in each triangle's bounding box.

    Both arrays have the shape (m, 2), with one column for x and one for y.
    """
    boxes = [lowest_and_highest(*corners[:, :, k].T) for k in range(2)]
    first = [np.searchsorted(axis, low) for axis, (low, _) in zip((x, y), boxes, strict=True)]
    last = [
        np.searchsorted(axis, high, side="right")
        for axis, (_, high) in zip((x, y), boxes, strict=True)
    ]
    return np.stack(first, axis=1), np.stack(last, axis=1) - np.stack(first, axis=1)


def lowest_and_highest(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Return the elementwise minimum and maximum of three arrays.

    NumPy's reductions are slow along an axis with three entries.
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
    """Return line index, height and sign (+1 entering) of each crossing of a line and a triangle.

    A triangle is only tested with the lines in its bounding box.
    """
    triangle, within = _repeated(counts[:, 0] * counts[:, 1])
    i = first[triangle, 0] + within // counts[triangle, 1]
    j = first[triangle, 1] + within % counts[triangle, 1]
    kept, height, sign = _crossings(corners, faces, triangle, x[i], y[j])
    return i[kept] * len(y) + j[kept], height, sign


def _crossings(
    corners: Array,
    faces: Ints,
    triangle: Ints,
    px: Array,
    py: Array,
) -> tuple[Flags, Array, Ints]:
    """Test whether the vertical line through (px[k], py[k]) crosses triangle ``triangle[k]``.

    Return flags, shape (n,), and the height and sign (+1 entering) of each crossing.
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
    """Keep the crossings at which the winding number becomes positive, or stops being positive."""
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
    # On a line through a hole of the surface, the winding number does not end at 0, so inside and
    # outside are unknown. The crossings of such a line are removed.
    unclosed = line[np.append(starts[1:], True) & (after != 0)]
    turns &= ~np.isin(line, unclosed)
    return ColumnCrossings(line[turns], height[turns], np.where(after[turns] > 0, 1, -1))


_LINES = 3
"""Number of lines through a voxel per axis x and y, that is, 3 x 3 lines."""
_WIDEST_LATTICE_M = 0.41e-3
"""Largest spacing [m] of the lattice for the depth: 0.4 mm, plus 0.01 mm for rounding errors."""
_CELLS_BEYOND = 4
"""Number of lattice cells beyond the depth threshold from which triangles are considered.

With this margin, the depth near the threshold is correct.
"""
_OFFSET = np.array([0.0137, 0.0071])
"""Shift of the lines along x and y, relative to the distance between lines.

With this shift, no edge of a box or of a symmetric mesh lies on a line.
"""


@dataclass(frozen=True, eq=False)
class TriangleSampler:
    """Function object that computes bone fraction and depth of voxels inside a closed surface.

    Attributes
    ----------
    vertices_m
        Vertices [m], shape (n, 3), in the frame of the grid.
    faces
        Triangles with outward normals, shape (m, 3).
    threshold_m
        Depth [m] at which the layer of a voxel changes. In cells of the sampling lattice whose
        depths are all on one side of the threshold, the computed depth may be inaccurate. It is
        still on the correct side of the threshold. If infinite, the depth is accurate everywhere.
    """

    vertices_m: Array
    faces: Ints
    threshold_m: float = np.inf

    @cached_property
    def _along_x(self) -> tuple[Array, Array]:
        """Lowest and highest x [m], shape (m,), of each triangle.

        These values select the triangles near a grid, because grids are slabs along x.
        """
        return lowest_and_highest(*np.ascontiguousarray(self.vertices_m[:, 0])[self.faces].T)

    def _within(self, grid: Grid, margin: float, axes: int) -> Ints:
        """Return the triangles whose bounding box overlaps the grid along the first `axes` axes.

        The grid is extended by a margin [m] for this test.
        """
        low = np.array(grid.first) * grid.spacing_m - margin
        high = np.array(grid.last) * grid.spacing_m + margin
        faces = self.faces[(self._along_x[0] <= high[0]) & (self._along_x[1] >= low[0])]
        for axis in range(1, axes):
            faces = triangles_meeting(self.vertices_m, faces, axis, low[axis], high[axis])
        return faces

    def __call__(self, grid: Grid) -> tuple[Singles, Singles]:
        """Compute the bone fraction, 0 to 1, and the depth [m] of the voxels of a grid.

        The depth is positive inside the surface. The two arrays are float32 and have the shape of
        `grid`, which must consist of whole blocks.

        The depth is computed only in lattice cells with bone. In lattice cells without bone, the
        depth has no meaning.
        """
        fraction = self._fraction(grid)
        return fraction, self._depth(grid, fraction)

    def _fraction(self, grid: Grid) -> Singles:
        nx, ny, nz = grid.shape
        pitch = grid.spacing_m / _LINES
        x = ((np.arange(nx * _LINES) + grid.first[0] * _LINES + 0.5) + _OFFSET[0]) * pitch
        y = ((np.arange(ny * _LINES) + grid.first[1] * _LINES + 0.5) + _OFFSET[1]) * pitch
        crossings = column_crossings(self.vertices_m, self._within(grid, grid.spacing_m, 2), x, y)
        level = np.clip(crossings.height / grid.spacing_m - grid.first[2], 0.0, nz)
        voxel = np.minimum(level.astype(np.int64), nz - 1)
        row = crossings.line // len(y) // _LINES
        column = crossings.line % len(y) // _LINES
        flat = (row * ny + column) * (nz + 1) + voxel
        size = nx * ny * (nz + 1)
        covered = crossings.entering * (voxel + 1 - level)
        change = np.bincount(flat, weights=covered, minlength=size)
        change += np.bincount(flat + 1, weights=crossings.entering - covered, minlength=size)
        filled = np.cumsum(change.reshape(nx, ny, nz + 1), axis=2)[:, :, :nz] / _LINES**2
        return np.clip(filled, 0.0, 1.0).astype(np.float32)

    def _depth(self, grid: Grid, fraction: Singles) -> Singles:
        step = next((n for n in (8, 4, 2) if n * grid.spacing_m <= _WIDEST_LATTICE_M), 1)
        bx, by, bz = (n // step for n in grid.shape)
        cells = fraction.reshape(bx, step, by, step, bz, step).max(axis=(1, 3, 5)) > 0.0
        corners = np.zeros((bx + 1, by + 1, bz + 1), dtype=np.float32)
        vertices = self.vertices_m
        faces = self.faces
        margin = np.inf
        if np.isfinite(self.threshold_m):
            margin = self.threshold_m + _CELLS_BEYOND * max(_WIDEST_LATTICE_M, grid.spacing_m)
            vertices, faces = compact(self.vertices_m, self._within(grid, margin, 3))
            needed = _corners_of(cells)
            points = (np.argwhere(needed) * step + grid.first) * grid.spacing_m
            deeper, shallower = np.ones((2, *needed.shape), dtype=bool)
            deeper[needed], shallower[needed] = _beyond(vertices, faces, points, self.threshold_m)
            corners[deeper] = margin
            cells &= ~(_whole_cells(deeper) | _whole_cells(shallower))
        needed = _corners_of(cells)
        if needed.any():
            points = (np.argwhere(needed) * step + grid.first) * grid.spacing_m
            depth = -triangle_distance(vertices, faces, points)
            # A point of a cell with bone that is so far from all kept triangles lies inside,
            # independent of the sign at the nearest triangle.
            corners[needed] = np.where(np.abs(depth) >= margin, np.abs(depth), depth)
        return refined(corners, step, axes=(0, 1, 2))


def refined(corners: Singles, step: int, *, axes: Iterable[int]) -> Singles:
    """Interpolate values linearly from lattice points to voxel centres, along the given axes.

    Along each axis, a cell of the lattice consists of `step` voxels.
    """
    weight = ((np.arange(step) + 0.5) / step).astype(np.float32)[:, None]
    for axis in axes:
        rows = np.moveaxis(corners, axis, -1)[..., None, :]
        low = rows[..., :-1]
        high = rows[..., 1:]
        between = np.swapaxes(low + (high - low) * weight, -1, -2)
        size = step * low.shape[-1]
        corners = np.moveaxis(between.reshape(*between.shape[:-2], size), -1, axis)
    return np.ascontiguousarray(corners)


def _beyond(vertices: Array, faces: Ints, points: Floats, threshold: float) -> tuple[Flags, Flags]:
    """Return flags of the points that are certainly farther than `threshold` from the triangles.

    Also return flags of the points that are certainly nearer. `threshold` is in metres. `points`
    has the shape (n, 3).

    The test only uses the distances from corners of triangles. Any point of a triangle has a corner
    within the longest side divided by the square root of three (Jung's theorem).
    """
    from scipy.spatial import cKDTree

    if len(faces) == 0:
        return np.ones(len(points), dtype=bool), np.zeros(len(points), dtype=bool)
    corners = vertices[faces]
    longest = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max())
    surely = threshold + longest / np.sqrt(3.0)
    to_vertex, _ = cKDTree(vertices).query(points, distance_upper_bound=surely)
    return to_vertex >= surely, to_vertex < threshold


def _corners_of(cells: Flags) -> Flags:
    """Return flags of the lattice points at the corners of flagged cells."""
    points = np.zeros(np.add(cells.shape, 1), dtype=bool)
    for i, j, k in np.ndindex(2, 2, 2):
        points[i : i + cells.shape[0], j : j + cells.shape[1], k : k + cells.shape[2]] |= cells
    return points


def _whole_cells(points: Flags) -> Flags:
    """Return flags of the cells whose corners are all flagged lattice points."""
    return ~_corners_of(~points)[1:-1, 1:-1, 1:-1]


def triangle_distance(vertices: Array, faces: Ints, points: Floats) -> Array:
    """Compute the signed distance [m], shape (n,), of points from a surface.

    The distance is negative inside.

    The points [m] have the shape (n, 3).
    """
    return surface_distance(vertices, faces)(points) if len(points) else np.empty(0)


def surface_distance(vertices: Array, faces: Ints) -> Callable[[Floats], Array]:
    """Return a function that computes `triangle_distance` for points and a fixed surface.

    Repeated calls are fast, because the triangles are sorted only once.
    """
    import pyvista
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkDoubleArray
    from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

    function = vtkImplicitPolyDataDistance()
    function.SetInput(pyvista.PolyData.from_regular_faces(vertices, faces.astype(int)))

    def distance(points: Floats) -> Array:
        found = vtkDoubleArray()
        at = np.ascontiguousarray(points, dtype=np.float64)
        function.FunctionValue(numpy_to_vtk(at), found)
        return np.array(vtk_to_numpy(found), dtype=np.float64)

    return distance


def nearest_on_triangles(vertices: Array, faces: Ints, points: Array) -> Array:
    """Return the surface points [m], shape (n, 3), that are nearest to the given points [m]."""
    import pyvista

    if len(points) == 0:
        return np.empty((0, 3))
    surface = pyvista.PolyData.from_regular_faces(vertices, faces.astype(int))
    _, found = surface.find_closest_cell(
        np.ascontiguousarray(points, dtype=np.float64), return_closest_point=True
    )
    return np.asarray(found, dtype=np.float64)
