"""Signed distances as expressions: `box(...) - cylinder(...) | sphere(...).translate(...)`.

A `Shape` maps points [m] to signed distances [m], negative inside. Every shape of this module is
1-Lipschitz, so the magnitude of its value never exceeds the true distance to the surface. If the
magnitude at the centre of a cell is larger than half the diagonal of the cell, the surface does not
cross the cell. A shape is called exact where its value is the true distance. Primitives are exact
everywhere unless their docstring states otherwise. A union of exact shapes is exact outside the
solid. An intersection or difference of exact shapes is exact inside the solid. At other points, the
magnitude of the value is a lower bound of the distance. The result has the dtype of the points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints, lattice
from meshes.base.errors import (
    InputError,
    in_brackets,
    require_direction,
    require_positive,
    require_vector,
)

Points = Floats
Distances = Floats
Vector = Sequence[float]

_EVERYWHERE = (-math.inf, -math.inf, -math.inf), (math.inf, math.inf, math.inf)


@dataclass(frozen=True)
class Shape:
    """Solid defined by its signed distance.

    Attributes
    ----------
    distance
        Function that takes points [m], shape (n, 3), and returns signed distances [m], shape (n,),
        with the same dtype (float32 or float64). Distances are negative inside.
    lower_m, upper_m
        Corners [m] of an axis-aligned box that contains the solid; infinite if the solid is
        unbounded.
    """

    distance: Callable[[Points], Distances]
    lower_m: tuple[float, ...] = _EVERYWHERE[0]
    upper_m: tuple[float, ...] = _EVERYWHERE[1]

    def __or__(self, other: Shape) -> Shape:
        return union(self, other)

    def __and__(self, other: Shape) -> Shape:
        return intersection(self, other)

    def __sub__(self, other: Shape) -> Shape:
        return difference(self, other)

    def translate(self, by_m: Vector) -> Shape:
        """Move the solid by the vector `by_m` [m], shape (3,)."""
        shift = require_vector("by_m", by_m)
        return _within(
            lambda p: self.distance(p - shift.astype(p.dtype)),
            np.add(self.lower_m, shift),
            np.add(self.upper_m, shift),
        )


def smooth_minimum(a: Distances, b: Distances, blend_m: float) -> Distances:
    """Return the minimum of two distances [m], with a smooth transition between them.

    The transition covers the region where the distances differ by less than `blend_m`.

    The blend is a quadratic polynomial (I. Quilez, "Smooth minimum"). The gradient of the result is
    a convex combination of the two gradients, so the result is 1-Lipschitz.
    """
    if blend_m <= 0.0:
        return np.minimum(a, b)
    overlap = np.maximum(blend_m - np.abs(a - b), 0.0)
    # With this factor, value and slope are continuous at the end of the blend.
    return np.minimum(a, b) - overlap * overlap * (0.25 / blend_m)


def smooth_maximum(a: Distances, b: Distances, blend_m: float) -> Distances:
    """Return the maximum of two distances [m], with a smooth transition (see `smooth_minimum`)."""
    return -smooth_minimum(-a, -b, blend_m)


def union(a: Shape, b: Shape, *, blend_m: float = 0.0) -> Shape:
    """Unite two solids; a positive `blend_m` [m] fills the crease between them."""
    # The blend lowers the distance by at most a quarter of its width, at points where the two
    # distances are equal.
    grown = 0.25 * blend_m
    lower = np.minimum(a.lower_m, b.lower_m) - grown
    upper = np.maximum(a.upper_m, b.upper_m) + grown
    return _within(lambda p: smooth_minimum(a.distance(p), b.distance(p), blend_m), lower, upper)


def intersection(a: Shape, b: Shape, *, blend_m: float = 0.0) -> Shape:
    """Intersect two solids; a positive `blend_m` [m] rounds the edge between them."""
    lower = np.maximum(a.lower_m, b.lower_m)
    upper = np.minimum(a.upper_m, b.upper_m)
    return _within(lambda p: smooth_maximum(a.distance(p), b.distance(p), blend_m), lower, upper)


def difference(a: Shape, b: Shape, *, blend_m: float = 0.0) -> Shape:
    """Subtract `b` from `a`; a positive `blend_m` [m] rounds the edge between them."""
    return Shape(
        lambda p: smooth_maximum(a.distance(p), -b.distance(p), blend_m), a.lower_m, a.upper_m
    )


def sphere(radius_m: float, centre_m: Vector = (0.0, 0.0, 0.0)) -> Shape:
    """Build a ball with the radius `radius_m` [m] and the centre `centre_m` [m]."""
    radius = require_positive("radius_m", radius_m, "use about 5e-3 (5 mm)")
    centre = require_vector("centre_m", centre_m)
    return _within(
        lambda p: _norm(p - centre.astype(p.dtype)) - radius, centre - radius, centre + radius
    )


def box(size_m: Vector, centre_m: Vector = (0.0, 0.0, 0.0), *, rounding_m: float = 0.0) -> Shape:
    """Build a box with edge lengths `size_m` [m], shape (3,).

    The edges are rounded with the radius `rounding_m` [m].

    Raises
    ------
    InputError
        If a length is not positive or the rounding exceeds half the shortest edge.
    """
    size = _extent("size_m", size_m, "(0.02, 0.012, 0.008)")
    centre = require_vector("centre_m", centre_m)
    if not 0.0 <= rounding_m <= 0.5 * float(size.min()):
        raise InputError(
            "rounding_m",
            f"be from 0 to {0.5 * float(size.min()):g}, half the shortest edge",
            rounding_m,
            "use 0 for sharp edges",
        )
    half = 0.5 * size - rounding_m

    def distance(p: Points) -> Distances:
        q = np.abs(p - centre.astype(p.dtype)) - half.astype(p.dtype)
        return _norm(np.maximum(q, 0.0)) + np.minimum(q.max(axis=1), 0.0) - rounding_m

    return _within(distance, centre - 0.5 * size, centre + 0.5 * size)


def cylinder(radius_m: float, start_m: Vector, end_m: Vector) -> Shape:
    """Build a cylinder of radius `radius_m` [m] with its axis from `start_m` to `end_m` [m]."""
    radius = require_positive("radius_m", radius_m, "use about 2e-3 (2 mm)")
    start, axis, length = _segment(start_m, end_m)

    def distance(p: Points) -> Distances:
        along, across = _cylindrical(p, start, axis)
        side = across - radius
        cap = np.abs(along - 0.5 * length) - 0.5 * length
        outside = np.sqrt(np.maximum(side, 0.0) ** 2 + np.maximum(cap, 0.0) ** 2)
        return outside + np.minimum(np.maximum(side, cap), 0.0)

    reach = radius * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
    ends = np.stack([start, start + length * axis])
    return _within(distance, ends.min(axis=0) - reach, ends.max(axis=0) + reach)


def capsule(radius_m: float, start_m: Vector, end_m: Vector) -> Shape:
    """Build a capsule around the segment from `start_m` to `end_m` [m].

    The capsule consists of all points whose distance from the segment is at most `radius_m` [m].
    """
    radius = require_positive("radius_m", radius_m, "use about 2e-3 (2 mm)")
    start, axis, length = _segment(start_m, end_m)

    def distance(p: Points) -> Distances:
        along, across = _cylindrical(p, start, axis)
        beyond = along - np.clip(along, 0.0, length)
        return np.sqrt(across**2 + beyond**2) - radius

    ends = np.stack([start, start + length * axis])
    return _within(distance, ends.min(axis=0) - radius, ends.max(axis=0) + radius)


def ellipsoid(radii_m: Vector, centre_m: Vector = (0.0, 0.0, 0.0)) -> Shape:
    """Build an ellipsoid with half axes `radii_m` [m], shape (3,).

    The distance is exactly zero on the surface. Elsewhere, its magnitude is only a lower bound of
    the true distance.

    For the half axes r and a point p relative to the centre, the signed distance is computed as
    (|p/r| - 1)·min(r). This value is 1-Lipschitz and zero on the surface. Along a half axis of
    length a, the value is min(r)/a times the true distance.
    """
    radii = _extent("radii_m", radii_m, "(0.02, 0.01, 0.01)")
    centre = require_vector("centre_m", centre_m)
    shortest = float(radii.min())
    return _within(
        lambda p: (_norm((p - centre.astype(p.dtype)) / radii.astype(p.dtype)) - 1.0) * shortest,
        centre - radii,
        centre + radii,
    )


def half_space(normal: Vector, point_m: Vector = (0.0, 0.0, 0.0)) -> Shape:
    """Build the half space bounded by the plane through `point_m` [m] with outward `normal`."""
    unit = require_direction("normal", normal)
    point = require_vector("point_m", point_m)
    offset = float(unit @ point)
    lower = np.full(3, -math.inf)
    upper = np.full(3, math.inf)
    for k in range(3):
        # Only a plane perpendicular to an axis bounds the box. 1e-15 is for the rounding error of
        # the unit vector.
        if math.isclose(abs(unit[k]), 1.0, rel_tol=0.0, abs_tol=1e-15):
            (upper if unit[k] > 0 else lower)[k] = point[k]
    return _within(lambda p: p @ unit.astype(p.dtype) - offset, lower, upper)


def _norm(v: Points) -> Distances:
    """Compute the Euclidean length of each row, in the dtype of the rows."""
    return np.sqrt(v[:, 0] ** 2 + v[:, 1] ** 2 + v[:, 2] ** 2)


def _cylindrical(p: Points, start: Array, axis: Array) -> tuple[Distances, Distances]:
    """Compute heights [m] of points above `start` along `axis`, and distances [m] from the axis."""
    q = p - start.astype(p.dtype)
    along = q @ axis.astype(p.dtype)
    return along, _norm(q - along[:, None] * axis.astype(p.dtype))


def _segment(start_m: Vector, end_m: Vector) -> tuple[Array, Array, float]:
    start = require_vector("start_m", start_m)
    end = require_vector("end_m", end_m)
    length = float(np.linalg.norm(end - start))
    if length == 0.0:
        raise InputError(
            "end_m",
            "differ from start_m",
            f"{in_brackets(end)} for both",
            "use a sphere for a point",
        )
    return start, (end - start) / length, length


def _extent(name: str, value: Vector, example: str) -> Array:
    extent = require_vector(name, value)
    if not np.all(extent > 0.0):
        raise InputError(
            name, "be positive in every direction", in_brackets(extent), f"use about {example}"
        )
    return extent


def _within(distance: Callable[[Points], Distances], lower: Array, upper: Array) -> Shape:
    """Build a shape from a distance function and two corners of its bounding box [m]."""
    return Shape(distance, tuple(lower.tolist()), tuple(upper.tolist()))


WANTED_M = 4e-6
"""Accepted distance of the triangles from the exact surface [m]."""
FIRST_POINTS = 1e5
MOST_POINTS = 1e6
"""Largest number of lattice points. The first lattice has `FIRST_POINTS` points."""
ROUNDS = 3
"""Largest number of lattices on which the distance is evaluated, each finer than the one before.

The spacing of the next lattice is computed from the error of the triangles on the last lattice.
"""
DOUBLINGS = 12
"""Largest number of enlargements of the search region, each by a factor of at most two."""
STEP_M = 1e-6
"""Step [m] of the finite differences for the gradient of a signed distance."""


def shape_triangles(shape: Shape, low_m: Array, high_m: Array) -> tuple[Array, Ints, float]:
    """Mesh the part of a shape's surface that is nearest to the points of a box.

    The triangles are computed on a lattice. The lattice is refined until the triangles are within
    0.004 mm of the surface, or the lattice has a million points.

    Parameters
    ----------
    low_m, high_m
        Corners [m], shape (3,), of the box.

    Returns
    -------
    vertices_m, faces, slack_m
        Vertices [m], shape (n, 3), triangles with outward normals, shape (m, 3), and the largest
        depth of the triangles below the surface [m]. For a shape with sharp convex edges, this
        depth occurs at the edges.

    Raises
    ------
    InputError
        If the shape has no surface in this region.
    """
    middle = 0.5 * (low_m + high_m)
    half = 0.5 * float(np.linalg.norm(high_m - low_m))
    reach = half + max(float(shape.distance(middle[None])[0]), 0.0)
    for _ in range(DOUBLINGS):
        start = np.maximum(middle - half - reach, shape.lower_m)
        end = np.minimum(middle + half + reach, shape.upper_m)
        low, high = _around_surface(shape, start, end)
        nearest = _nearest(shape, low, high, middle)
        # A surface point cannot be nearest to a point of the box if its distance from the middle of
        # the box exceeds the distance of the nearest surface point plus the size of the box. The
        # distance of a shape may be a lower bound, so the first reach may be too short.
        if half + nearest <= reach:
            break
        reach = min(half + nearest, 2.0 * reach)
    else:
        raise InputError(
            "keep_clear",
            "name a structure with a surface",
            "an empty surface",
            "leave this structure out",
        )
    volume = float(np.prod(high - low))
    finest, spacing = ((volume / count) ** (1.0 / 3.0) for count in (MOST_POINTS, FIRST_POINTS))
    for _ in range(ROUNDS):
        vertices, faces, on_surface = _contour(shape, low, high, spacing)
        slack = _slack(shape, vertices, faces[on_surface[faces].all(axis=1)])
        if slack <= WANTED_M or spacing <= finest:
            break
        # The depth is proportional to the square of the spacing, except at sharp edges. The spacing
        # has a margin of a tenth, and one step refines it by at most a factor of five.
        spacing = max(spacing * max(0.9 * (WANTED_M / slack) ** 0.5, 0.2), finest)
    return vertices, faces, slack


def _around_surface(shape: Shape, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the corners of a box around all coarse lattice cells that the surface may cross.

    If there is no such cell, the box is the whole lattice.
    """
    if not (low < high).all():
        return low, high
    count = np.maximum(
        np.ceil((high - low) / np.cbrt(np.prod(high - low) / FIRST_POINTS)).astype(int), 1
    )
    sides = (high - low) / count
    centres = (lattice(*map(np.arange, count)) + 0.5) * sides + low
    near = centres[np.abs(shape.distance(centres)) <= 0.5 * np.linalg.norm(sides)]
    if not len(near):
        return low, high
    # Half a cell from centre to face, plus a tolerance for rounding.
    return np.maximum(near.min(axis=0) - 0.51 * sides, low), np.minimum(
        near.max(axis=0) + 0.51 * sides, high
    )


def _nearest(shape: Shape, low: Array, high: Array, middle: Array) -> float:
    """Compute the distance [m] of a point from a coarse mesh of the surface in a box.

    The distance is measured to the nearest vertex, and is infinite if the mesh is empty.
    """
    if not (low < high).all():
        return np.inf
    vertices = _contour(shape, low, high, float(np.cbrt(np.prod(high - low) / FIRST_POINTS)))[0]
    return float(np.linalg.norm(vertices - middle, axis=1).min(initial=np.inf))


def _contour(shape: Shape, low: Array, high: Array, spacing: float) -> tuple[Array, Ints, Flags]:
    """Return a closed mesh of the shape on a lattice, and flags of the vertices on its surface.

    The other vertices close the mesh where the lattice cuts off the shape.
    """
    from skimage.measure import marching_cubes

    # The lattice extends outside the box on all sides, and the surface is closed there.
    first = low - 1.5 * spacing
    count = np.ceil((high - low) / spacing).astype(int) + 4
    grid = lattice(*map(np.arange, count)) * spacing + first
    values = np.asarray(shape.distance(grid), dtype=np.float64).reshape(count)
    padded = np.pad(values, 1, constant_values=spacing)
    if not padded.min() < 0.0:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=bool)
    vertices, faces, _, _ = marching_cubes(padded, 0.0)
    at = first + (vertices.astype(np.float64) - 1.0) * spacing
    within = ((vertices > 1.0) & (vertices < np.array(padded.shape) - 2.0)).all(axis=1)
    offset, slope = _to_surface(shape, at[within])
    at[within] -= np.clip(offset, -spacing, spacing)[:, None] * slope
    return at, faces.astype(np.int64), within


def _slack(shape: Shape, vertices: Array, faces: Ints) -> float:
    """Compute the largest depth [m] of triangle centres and edges below the surface.

    Triangles that lie outside the surface, as at concave edges, are not counted. They make the
    distance of an outside point too small, which is on the safe side.
    """
    corners = vertices[faces]
    points = np.concatenate(
        [corners.mean(axis=1), *(0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3))]
    )
    return float(-_to_surface(shape, points)[0].min(initial=0.0))


def _to_surface(shape: Shape, points: Array) -> tuple[Array, Array]:
    """Compute the signed distance [m] to the surface along the gradient, and the unit gradient.

    This distance is more accurate than the shape's value, which may be only a bound of the
    distance.
    """
    value = np.asarray(shape.distance(points), dtype=np.float64)
    slope = np.empty_like(points)
    for axis in range(3):
        step = STEP_M * np.eye(3)[axis]
        slope[:, axis] = (shape.distance(points + step) - shape.distance(points - step)) / (
            2.0 * STEP_M
        )
    # The slope is at most 1. The limit of 0.05 bounds the step at creases, where finite differences
    # may be zero.
    steep = np.maximum(np.linalg.norm(slope, axis=1), 0.05)
    return value / steep, slope / steep[:, None]
