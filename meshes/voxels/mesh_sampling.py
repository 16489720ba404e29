"""Bone fraction and depth of voxels under a triangle surface.

Fraction: each voxel column holds 3 x 3 lines along z. A line's winding number changes where it
crosses the triangles, and its parts with a positive winding number are bone. This is exact along z
and a quadrature of nine lines across. Depth: the distance to the surface on a lattice of 0.4 mm or
a voxel, interpolated to the voxels.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints, Singles
from meshes.base.simplices import compact
from meshes.voxels.column_crossings import column_crossings, lowest_and_highest, triangles_meeting
from meshes.voxels.grid import Grid

__all__ = ["TriangleSampler", "nearest_on_triangles", "triangle_distance"]

_LINES = 3
_WIDEST_LATTICE_M = 0.41e-3
_CELLS_BEYOND = 4
_OFFSET = np.array([0.0137, 0.0071])


@dataclass(frozen=True, eq=False)
class TriangleSampler:
    """Fraction and depth of the voxels of a grid under a closed surface.

    Attributes
    ----------
    vertices_m
        Vertices in the frame of the grid [m], shape (n, 3).
    faces
        Triangles wound outward, shape (m, 3).
    threshold_m
        Depth that decides the layer of a voxel: in lattice cells that lie wholly on one side of it
        the depth is only on that side. Infinite: the depth is right everywhere.
    """

    vertices_m: Array
    faces: Ints
    threshold_m: float = np.inf

    @cached_property
    def _along_x(self) -> tuple[Array, Array]:
        """Lowest and highest x of each triangle [m], shape (m,): grids are slabs along x."""
        return lowest_and_highest(*np.ascontiguousarray(self.vertices_m[:, 0])[self.faces].T)

    def _within(self, grid: Grid, margin: float, axes: int) -> Ints:
        """Return triangles whose box overlaps the grid's box along its first `axes` axes.

        The grid's box is grown by a margin [m].
        """
        low = np.array(grid.first) * grid.spacing_m - margin
        high = np.array(grid.last) * grid.spacing_m + margin
        faces = self.faces[(self._along_x[0] <= high[0]) & (self._along_x[1] >= low[0])]
        for axis in range(1, axes):
            faces = triangles_meeting(self.vertices_m, faces, axis, low[axis], high[axis])
        return faces

    def __call__(self, grid: Grid) -> tuple[Singles, Singles]:
        """Compute bone fraction, 0 to 1, and depth [m], positive inside.

        Both are float32 with the shape of the blocked grid.

        The depth is computed only in lattice cells that hold bone; elsewhere it is meaningless.
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
            # So far from all that was kept, a point of a cell with bone lies inside, whatever the
            # sign of the nearest.
            corners[needed] = np.where(np.abs(depth) >= margin, np.abs(depth), depth)
        weight = ((np.arange(step) + 0.5) / step).astype(np.float32)
        for axis in range(3):
            low = np.delete(corners, -1, axis=axis)
            high = np.delete(corners, 0, axis=axis)
            shape = list(low.shape)
            shape[axis] *= step
            along = weight.reshape([-1 if k == axis + 1 else 1 for k in range(4)])
            low = np.expand_dims(low, axis + 1)
            high = np.expand_dims(high, axis + 1)
            corners = (low + (high - low) * along).reshape(shape)
        return corners


def _beyond(vertices: Array, faces: Ints, points: Floats, threshold: float) -> tuple[Flags, Flags]:
    """Return flags of the points that are surely farther from the triangles than a threshold [m].

    Also return flags of the points that are surely nearer. Points have the shape (n, 3).

    No point of a triangle is farther from its nearest corner than its longest side over the root of
    three (Jung).
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
    """Return lattice points at the corners of cells."""
    points = np.zeros(np.add(cells.shape, 1), dtype=bool)
    for i, j, k in np.ndindex(2, 2, 2):
        points[i : i + cells.shape[0], j : j + cells.shape[1], k : k + cells.shape[2]] |= cells
    return points


def _whole_cells(points: Flags) -> Flags:
    """Return cells with all corners among the lattice points."""
    return ~_corners_of(~points)[1:-1, 1:-1, 1:-1]


def triangle_distance(vertices: Array, faces: Ints, points: Floats) -> Array:
    """Compute the signed distance [m] of points from the surface, negative inside, shape (n,).

    The points [m] have the shape (n, 3).
    """
    import pyvista

    if len(points) == 0:
        return np.empty(0)
    surface = pyvista.PolyData.from_regular_faces(vertices, faces.astype(int))
    cloud = pyvista.PolyData(np.ascontiguousarray(points, dtype=np.float64))
    found = cloud.compute_implicit_distance(surface)
    return np.asarray(found["implicit_distance"], dtype=np.float64)


def nearest_on_triangles(vertices: Array, faces: Ints, points: Array) -> Array:
    """Return the point of the surface nearest to each point [m], shape (n, 3)."""
    import pyvista

    if len(points) == 0:
        return np.empty((0, 3))
    surface = pyvista.PolyData.from_regular_faces(vertices, faces.astype(int))
    _, found = surface.find_closest_cell(
        np.ascontiguousarray(points, dtype=np.float64), return_closest_point=True
    )
    return np.asarray(found, dtype=np.float64)
