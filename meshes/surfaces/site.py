"""Site on a bone surface where a tool works, and sample points of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Floats, Ints, cross_products
from meshes.base.errors import InputError, in_brackets, require_direction, require_vector
from meshes.base.placement import Placement
from meshes.surfaces.repair import triangle_areas
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import column_crossings

FACE_SAMPLES = 40_000
"""Number of surface samples from which the normal of a site is computed.

On a scapula, the samples are 0.5 mm apart.
"""
FARTHEST_M = 10e-3
"""Largest distance [m] of a given site centre from the surface.

A larger distance indicates that the centre is given in another frame or unit.
"""
_AROUND_M = 3e-3
"""Radius [m] within which normals are averaged, larger than facets and voxel steps."""
_LEAST_ACROSS = 0.02  # sine of the smallest angle between x and the normal, one degree


@dataclass(frozen=True, eq=False)
class Site:
    """Location on a surface at which a tool works.

    Attributes
    ----------
    centre_m
        Point of the surface at the centre of the working face [m], shape (3,), in the surface's
        frame.
    rotation
        Matrix, shape (3, 3), whose columns are the axes of the site in the surface's frame. The
        axes are right-handed, and z points outward. For a glenoid that was found by search, y
        points superiorly. x points anteriorly on a right scapula and posteriorly on a left scapula.
    confidence
        Sentence that describes how the site was found and how reliable the result is.
    """

    centre_m: Array
    rotation: Array
    confidence: str

    def to_site(self, points_m: Floats) -> Array:
        """Convert points [m], shape (n, 3), from the surface's frame to the site frame."""
        return (np.asarray(points_m, dtype=np.float64) - self.centre_m) @ self.rotation

    def within(self, outer: Placement) -> Site:
        """Convert this site to the frame of a file.

        `outer` is the placement of this site's frame in the file.
        """
        centre = 1e-3 * outer.origin_mm + outer.rotation @ self.centre_m
        return Site(centre, outer.rotation @ self.rotation, self.confidence)

    def placement(self, unit_mm: float) -> Placement:
        """Return the placement of the site in a file whose length unit is `unit_mm` [mm]."""
        return Placement(1e3 * self.centre_m, self.rotation, unit_mm)


@dataclass(frozen=True, eq=False)
class FoundSite:
    """Result of a search for a landmark on a bone.

    Attributes
    ----------
    site
        Best site.
    score
        Quality of the match, 0 to 1.
    second_score
        Score of the second-best place, which is not close to the site; 0 if there is no second
        place.
    second_centre_mm
        Centre [mm], shape (3,), of the second-best place in the frame of the surface; None if there
        is no second place.
    """

    site: Site
    score: float
    second_score: float = 0.0
    second_centre_mm: Array | None = None


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points that are evenly distributed on a surface.

    Attributes
    ----------
    points, normals
        Positions [m] and outward unit normals, shape (n, 3).
    area
        Surface area [m2] that each point represents.
    """

    points: Array
    normals: Array
    area: float


def sample_surface(vertices: Array, faces: Ints, count: int) -> SurfaceSamples:
    """Distribute `count` points over a surface, with the same area per point.

    The points are reproducible, because their positions in the triangles follow a Kronecker
    sequence.
    """
    total = np.cumsum(triangle_areas(vertices, faces))
    chosen = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    chosen = np.minimum(chosen, len(faces) - 1)
    # Steps 1/p and 1/p^2 of the plastic number p: the sequence R2 of Roberts (2018), even in a
    # square.
    shares = np.modf(
        np.arange(count)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])
    )[0]
    outside = shares.sum(axis=1) > 1.0  # points in the other half of the parallelogram
    shares[outside] = 1.0 - shares[outside]
    u, v = shares.T
    a, b, c = (vertices[faces[chosen, k]] for k in range(3))
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    cross = cross_products(vertices, faces[chosen])
    return SurfaceSamples(
        points, cross / np.linalg.norm(cross, axis=1)[:, None], float(total[-1]) / count
    )


def refusal(surface: Surface, what: str, got: str) -> InputError:
    """Return the error for a search that did not find the landmark `what`."""
    return InputError(
        "file",
        f"contain a {what}",
        f"{got} in {surface.report.source}",
        "check the unit of the file, extract one bone by labels or a crop, or give a centre and a "
        "normal",
    )


def across(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors that are perpendicular to each other and to an axis."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def spread(heights: Floats, axis: Array) -> Array:
    """Return unit vectors, shape (n, 3), on a golden-angle spiral around an axis.

    `heights` are the cosines of the angles between the vectors and the axis.
    """
    u, v = across(axis)
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(len(heights))
    around = np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v)
    return heights[:, None] * axis + np.sqrt(1.0 - heights**2)[:, None] * around


def place_site(
    surface: Surface,
    *,
    centre_mm: Sequence[float],
    normal: Sequence[float] | None = None,
    along: Sequence[float] | None = None,
) -> Site:
    """Return the site at a given point of a bone of any kind.

    Parameters
    ----------
    surface
        The bone.
    centre_mm
        Point [mm] in the frame of the file, after scaling to mm. The point is moved along the
        normal onto the surface.
    normal
        Outward vector at this point, with any length. If None, it is the mean normal of the surface
        within 3 mm of the nearest surface point.
    along
        Vector in the direction of the site's x axis, with any length. The vector is projected onto
        the plane perpendicular to the normal. If None, y points away from the middle of the bone.

    Raises
    ------
    InputError
        If the centre is not on the surface, a direction is zero, or `along` is parallel to the
        normal.
    """
    centre = require_vector("anatomy.centre_mm", centre_mm) * 1e-3
    note = "centre and normal as given"
    if normal is None:
        samples = sample_surface(*surface.scanned, FACE_SAMPLES)
        axis = normal_near(samples, centre)
        note = "centre as given, normal of the surface around it"
    else:
        axis = require_direction("anatomy.normal", normal, "give the outward direction")
    if along is not None:
        note = f"{note}, x along the direction given"
    return site_along(surface, centre, axis, note, along)


def site_along(
    surface: Surface,
    centre: Array,
    normal: Array,
    note: str,
    along: Sequence[float] | None = None,
    long_axis: Array | None = None,
) -> Site:
    """Return the site at the point where the line along a normal leaves the bone.

    Parameters
    ----------
    surface
        The bone.
    centre, normal
        Point [m] and unit normal, shapes (3,).
    note
        Description of the method that found the site.
    along
        Direction of the site's x axis. If None, y points away from the middle of the bone and, if
        `long_axis` is given, is parallel to `long_axis`.
    long_axis
        Direction of the site's y axis, with arbitrary sign.

    Raises
    ------
    InputError
        If the line does not leave the bone within 10 mm of the point, or `along` is parallel to the
        normal.
    """
    if along is None:
        middle = sample_surface(*surface.scanned, FACE_SAMPLES).points.mean(axis=0)
        rotation = _axes(normal, middle - centre, long_axis)
    else:
        rotation = axes_along(normal, along)
    return Site(_on_surface(surface, centre, rotation), rotation, note)


def axes_along(normal: Array, along: Sequence[float]) -> Array:
    """Return a matrix, shape (3, 3), whose columns are orthogonal axes with z along a normal.

    z is the unit vector `normal`, and x is as close to the direction `along` as possible.

    Raises
    ------
    InputError
        If `along` is zero, or its angle to the normal is less than one degree.
    """
    direction = require_direction("anatomy.along", along, "give a direction across the normal")
    projected = direction - (direction @ normal) * normal
    if np.linalg.norm(projected) < _LEAST_ACROSS:
        raise InputError(
            "anatomy.along",
            f"not be parallel to the normal {in_brackets(normal, '.4g')}",
            in_brackets(direction, ".4g"),
            "give a direction in the plane of the site",
        )
    x = projected / np.linalg.norm(projected)
    return np.column_stack([x, np.cross(normal, x), normal])


def normal_near(samples: SurfaceSamples, centre: Array) -> Array:
    """Compute the mean unit normal of the surface near a point, shape (3,).

    The mean is taken over the sample points within 3 mm of the surface point nearest to `centre`
    [m].
    """
    distance = np.linalg.norm(samples.points - centre, axis=1)
    nearest = int(np.argmin(distance))
    around = np.linalg.norm(samples.points - samples.points[nearest], axis=1) < _AROUND_M
    # Only normals within 60 degrees are used, because the other side of a thin bone may be within 3
    # mm.
    facing = samples.normals @ samples.normals[nearest] > 0.5
    mean = samples.normals[around & facing].sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _axes(
    normal: Array,
    to_middle: Array,
    long_axis: Array | None,
) -> Array:
    """Return site axes as columns: z along `normal`, y along `long_axis` if it is given.

    y points away from the middle of the bone.

    On a scapula, y is then the superior direction, because the body of the scapula lies below the
    glenoid.
    """
    away = -(to_middle - (to_middle @ normal) * normal)
    if long_axis is not None:
        y = long_axis - (long_axis @ normal) * normal
        y = y if y @ away >= 0.0 else -y
    # If the middle of the bone is less than 1 um from the axis, its direction is only a rounding
    # error.
    elif np.linalg.norm(away) > 1e-6:
        y = away
    else:
        y, _ = across(normal)
    y = y / np.linalg.norm(y)
    return np.column_stack([np.cross(y, normal), y, normal])


def exits(surface: Surface, point: Array, rotation: Array) -> Array:
    """Return the heights [m], shape (k,), at which a line leaves the bone.

    The line passes through `point` along the z axis of `rotation`. Heights are measured along the
    line, starting at the point.
    """
    on_line = np.array([1e-9])  # off the axis, because edges of symmetric meshes lie on it
    found = column_crossings(
        (surface.vertices_m - point) @ rotation, surface.faces, on_line, on_line
    )
    return found.height[found.entering < 0]


def corner_near(surface: Surface, point: Floats) -> Array:
    """Return the surface vertex [m], shape (3,), that is nearest to a point [m]."""
    distance = np.linalg.norm(surface.vertices_m - point, axis=1)
    return np.asarray(surface.vertices_m[np.argmin(distance)])


def _on_surface(surface: Surface, centre: Array, rotation: Array) -> Array:
    """Find the point where the z axis of `rotation` through `centre` leaves the bone.

    If there are several such points within 10 mm, the point nearest to `centre` is returned.
    """
    leaving = exits(surface, centre, rotation)
    nearest = float(leaving[np.argmin(np.abs(leaving))]) if len(leaving) else np.inf
    if abs(nearest) > FARTHEST_M:
        given, corner = (
            in_brackets(1e3 * point, ".4g") for point in (centre, corner_near(surface, centre))
        )
        raise InputError(
            "anatomy.centre_mm",
            "lie within 10 mm of the surface along the normal",
            f"{given} mm in {surface.report.source}",
            (
                "give a point on the face, in mm in the frame of the file. The nearest vertex "
                f"is at {corner} mm"
            ),
        )
    return centre + nearest * rotation[:, 2]
