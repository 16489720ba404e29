"""Triangles around a shape, with a bound of their distance from its surface."""

import numpy as np

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from meshes.shapes.sdf import Shape

__all__ = ["shape_triangles"]

WANTED_M = 4e-6
"""Target distance of the triangles from the surface [m]."""
FIRST_POINTS = 1e5
MOST_POINTS = 1e6
"""Points of the first and of the finest lattice on which the distance is evaluated."""
ROUNDS = 3
DOUBLINGS = 12
STEP_M = 1e-6
"""Step of the finite differences for the gradient of a distance [m]."""


def shape_triangles(shape: Shape, low_m: Array, high_m: Array) -> tuple[Array, Ints, float]:
    """Mesh all of a shape's surface that can be nearest to a box.

    The lattice is refined until the triangles lie within 0.004 mm of the surface, or it has a
    million points.

    Parameters
    ----------
    low_m, high_m
        Corners of the box [m], shape (3,).

    Returns
    -------
    vertices_m, faces, slack_m
        Vertices [m], shape (n, 3), triangles wound outward, shape (m, 3), and their largest depth
        below the surface [m]. Sharp convex edges, if any, determine this depth.

    Raises
    ------
    InputError
        If the shape has no surface there.
    """
    middle = 0.5 * (low_m + high_m)
    half = 0.5 * float(np.linalg.norm(high_m - low_m))
    reach = half + max(float(shape.distance(middle[None])[0]), 0.0)
    for _ in range(DOUBLINGS):
        start = np.maximum(middle - half - reach, shape.lower_m)
        end = np.minimum(middle + half + reach, shape.upper_m)
        low, high = _around_surface(shape, start, end)
        nearest = _nearest(shape, low, high, middle)
        # A point farther from the middle than its nearest point and the box together is nearest
        # to no point of it. The distance of a shape may be a lower bound, so that the first reach
        # may be too short.
        if half + nearest <= reach:
            break
        reach = min(half + nearest, 2.0 * reach)
    else:
        raise InputError(
            "keep_clear", "name a structure with a surface", "an empty one", "leave it out"
        )
    volume = float(np.prod(high - low))
    finest, spacing = ((volume / count) ** (1.0 / 3.0) for count in (MOST_POINTS, FIRST_POINTS))
    for _ in range(ROUNDS):
        vertices, faces, on_surface = _contour(shape, low, high, spacing)
        slack = _slack(shape, vertices, faces[on_surface[faces].all(axis=1)])
        if slack <= WANTED_M or spacing <= finest:
            break
        spacing = max(spacing * max(0.9 * (WANTED_M / slack) ** 0.5, 0.2), finest)
    return vertices, faces, slack


def _around_surface(shape: Shape, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the corners of a box around the coarse lattice cells that may hold surface.

    If no cell does, the box is the whole lattice.
    """
    if not (low < high).all():
        return low, high
    count = np.maximum(
        np.ceil((high - low) / np.cbrt(np.prod(high - low) / FIRST_POINTS)).astype(int), 1
    )
    sides = (high - low) / count
    centres = (
        np.moveaxis(np.indices(tuple(count.tolist())), 0, -1).reshape(-1, 3) + 0.5
    ) * sides + low
    near = centres[np.abs(shape.distance(centres)) <= 0.5 * np.linalg.norm(sides)]
    if not len(near):
        return low, high
    return np.maximum(near.min(axis=0) - 0.51 * sides, low), np.minimum(
        near.max(axis=0) + 0.51 * sides, high
    )


def _nearest(shape: Shape, low: Array, high: Array, middle: Array) -> float:
    """Compute the distance [m] of a point from the nearest vertex of a coarse surface in a box.

    It is infinite if there is no vertex.
    """
    if not (low < high).all():
        return np.inf
    vertices = _contour(shape, low, high, float(np.cbrt(np.prod(high - low) / FIRST_POINTS)))[0]
    return float(np.linalg.norm(vertices - middle, axis=1).min(initial=np.inf))


def _contour(shape: Shape, low: Array, high: Array, spacing: float) -> tuple[Array, Ints, Flags]:
    """Extract closed triangles at distance 0, and flags of the vertices that lie on the surface.

    The other vertices lie where the lattice cuts the surface off.
    """
    from skimage.measure import marching_cubes

    first = low - 1.5 * spacing
    count = np.ceil((high - low) / spacing).astype(int) + 4
    grid = np.moveaxis(np.indices(tuple(count.tolist())), 0, -1).reshape(-1, 3) * spacing + first
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
    """Compute the largest depth of centres and edges of triangles below the surface [m].

    Triangles outside the surface, in concave edges, make a distance too small, which is the safe
    side.
    """
    corners = vertices[faces]
    points = np.concatenate(
        [corners.mean(axis=1), *(0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3))]
    )
    return float(-_to_surface(shape, points)[0].min(initial=0.0))


def _to_surface(shape: Shape, points: Array) -> tuple[Array, Array]:
    """Compute the signed distance from the surface along the gradient [m] and the unit gradient.

    The shape's value alone is only a bound.
    """
    value = np.asarray(shape.distance(points), dtype=np.float64)
    slope = np.empty_like(points)
    for axis in range(3):
        step = STEP_M * np.eye(3)[axis]
        slope[:, axis] = (shape.distance(points + step) - shape.distance(points - step)) / (
            2.0 * STEP_M
        )
    steep = np.maximum(np.linalg.norm(slope, axis=1), 0.05)
    return value / steep, slope / steep[:, None]
