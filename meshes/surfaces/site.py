"""The working site on a bone surface: its centre and its axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, in_brackets, require_direction, require_vector
from meshes.base.placement import Placement
from meshes.surfaces.glenoid_search import Face, SurfaceSamples, best_seeds, grow_face, sample_surface
from meshes.surfaces.surface import Surface
from meshes.voxels.column_crossings import column_crossings

__all__ = ["FoundSite", "Site", "axes_along", "find_glenoid", "place_site", "search_glenoid", "site_along"]

_SAMPLES, _FACE_SAMPLES = 8000, 40000
_LEAST_SCORE = 0.25
_WIDTH_M, _LENGTH_M = (18e-3, 36e-3), (26e-3, 48e-3)
_FARTHEST_M = 10e-3
_FLAT_M = 0.2
_AROUND_M = 3e-3
_LEAST_ACROSS = 0.02


@dataclass(frozen=True, eq=False)
class Site:
    """Where to work on a surface.

    Attributes
    ----------
    centre_m
        Point of the surface at the centre of the working face [m], in the surface's frame, shape (3,).
    rotation
        Site axes as columns in the surface's frame, shape (3, 3), right-handed, z outward. Of a glenoid that was
        searched for y is superior, x anterior on a right scapula and posterior on a left one.
    confidence
        How it was found and how sure that is, a sentence.
    """

    centre_m: NDArray[np.float64]
    rotation: NDArray[np.float64]
    confidence: str

    def to_site(self, points_m: NDArray[np.floating]) -> NDArray[np.float64]:
        """Points [m], shape (n, 3), from the surface's frame to the site frame."""
        return (np.asarray(points_m, dtype=np.float64) - self.centre_m) @ self.rotation

    def within(self, outer: Placement) -> Site:
        """The same site in the frame of the file in which the frame of this one is placed."""
        centre = 1e-3 * outer.origin_mm + outer.rotation @ self.centre_m
        return Site(centre, outer.rotation @ self.rotation, self.confidence)

    def placement(self, unit_mm: float) -> Placement:
        """Where the site lies in a file with units of that length [mm]."""
        return Placement(1e3 * self.centre_m, self.rotation, unit_mm)


@dataclass(frozen=True, eq=False)
class FoundSite:
    """A site that was searched for.

    Attributes
    ----------
    site
        The best place.
    score
        How well it fits, 0 to 1.
    second_score
        Score of the best place well apart from it; 0 where there is none that fits at all.
    second_centre_mm
        That place [mm] in the frame of the surface, shape (3,); None where there is none.
    """

    site: Site
    score: float
    second_score: float
    second_centre_mm: NDArray[np.float64] | None


def find_glenoid(
    surface: Surface, *, centre_mm: Sequence[float] | None = None, along: Sequence[float] | None = None
) -> Site:
    """Find the plane of a scapula's glenoid, and the glenoid itself where its centre is not given.

    Parameters
    ----------
    surface
        A scapula.
    centre_mm
        Its centre [mm] in the frame of the file after scaling; moved along the normal onto the surface. None: searched
        for.
    along
        Direction that becomes x, projected onto the face, any length. None: y is superior.

    Raises
    ------
    InputError
        If nothing on the surface looks like a glenoid, the centre is off the surface, or `along` is normal to the face.
    """
    if centre_mm is not None:
        samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
        centre = require_vector("anatomy.centre_mm", centre_mm) * 1e-3
        near = int(np.argmin(np.linalg.norm(samples.points - centre, axis=1)))
        normal = grow_face(samples, samples.points[near], samples.normals[near]).normal
        return _site(surface, centre, normal, along, "centre as given, normal of the face around it")
    return search_glenoid(surface, along=along).site


def search_glenoid(surface: Surface, *, along: Sequence[float] | None = None) -> FoundSite:
    """Search a scapula for its glenoid; `along` and errors as in `find_glenoid`."""
    best, second = best_seeds(sample_surface(*surface.scanned, _SAMPLES))
    score = best.score
    face = grow_face(sample_surface(*surface.scanned, _FACE_SAMPLES), best.point_m, best.normal)
    plausible = _WIDTH_M[0] <= face.width_m <= _WIDTH_M[1] and _LENGTH_M[0] <= face.length_m <= _LENGTH_M[1]
    if score < _LEAST_SCORE or not plausible:
        raise InputError(
            f"file must show a glenoid of about 28 x 37 mm, got none in {surface.report.source} (best "
            "face "
            f"{_size(face)}, score {score:.2f}): check anatomy.scale_mm, or give anatomy.centre_mm and "
            "anatomy.normal"
        )
    radius = face.curvature_radius_m
    bend = "concave" if radius > 0.0 else "convex"
    shape = "flat" if abs(radius) > _FLAT_M else f"{bend}, radius {1e3 * abs(radius):.0f} mm"
    note = f"found by search: face {_size(face)}, {shape}, score {score:.2f} of 1; check it in the picture"
    site = _site(surface, face.centre_m, face.normal, along, note, face.long_axis)
    return FoundSite(site, score, second.score, None if second.score == 0.0 else 1e3 * second.point_m)


def place_site(
    surface: Surface,
    *,
    centre_mm: Sequence[float],
    normal: Sequence[float] | None = None,
    along: Sequence[float] | None = None,
) -> Site:
    """Site at a given point of any bone.

    Parameters
    ----------
    surface
        The bone.
    centre_mm
        Point [mm] in the frame of the file after scaling; moved along the normal onto the surface.
    normal
        Outward direction there, any length. None: the mean normal of the surface within 3 mm of the nearest point.
    along
        Direction that becomes x, projected onto the plane across the normal, any length. None: y leads away from the
        middle of the bone.

    Raises
    ------
    InputError
        If the centre is off the surface, a direction is zero, or `along` is along the normal.
    """
    centre, note = require_vector("anatomy.centre_mm", centre_mm) * 1e-3, "centre and normal as given"
    if normal is None:
        samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
        axis, note = _normal_near(samples, centre), "centre as given, normal of the surface around it"
    else:
        axis = require_direction("anatomy.normal", normal, "give the outward direction")
    return _site(surface, centre, axis, along, note if along is None else f"{note}, x along the direction given")


def site_along(surface: Surface, centre_m: NDArray[np.float64], normal: NDArray[np.float64], note: str) -> Site:
    """Site where the line through a point [m] along a unit normal leaves the bone, y away from the bone's middle.

    Raises
    ------
    InputError
        If the line leaves the bone nowhere within 10 mm of the point.
    """
    return _site(surface, centre_m, normal, None, note)


def _site(
    surface: Surface,
    centre: NDArray[np.float64],
    normal: NDArray[np.float64],
    along: Sequence[float] | None,
    note: str,
    long_axis: NDArray[np.float64] | None = None,
) -> Site:
    """Site where the normal through a point leaves the bone; x along a direction, or y away from the bone's middle."""
    if along is None:
        middle = sample_surface(*surface.scanned, _FACE_SAMPLES).points.mean(axis=0)
        rotation = _axes(normal, middle - centre, long_axis)
    else:
        rotation = axes_along(normal, along)
    return Site(_on_surface(surface, centre, rotation), rotation, note)


def axes_along(normal: NDArray[np.float64], along: Sequence[float]) -> NDArray[np.float64]:
    """Axes as columns, shape (3, 3): z the unit vector `normal`, x as close to the direction `along` as it can be.

    Raises
    ------
    InputError
        If `along` is zero or within a degree of the normal.
    """
    direction = require_direction("anatomy.along", along, "give a direction across the normal")
    across = direction - (direction @ normal) * normal
    if np.linalg.norm(across) < _LEAST_ACROSS:
        raise InputError(
            f"anatomy.along must lead across the normal {in_brackets(normal, '.4g')}, got "
            f"{in_brackets(direction, '.4g')}: give a direction in the plane of the site"
        )
    x = across / np.linalg.norm(across)
    return np.column_stack([x, np.cross(normal, x), normal])


def _normal_near(samples: SurfaceSamples, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean normal of the samples around the one nearest to a point that face its direction."""
    distance = np.linalg.norm(samples.points - centre, axis=1)
    nearest = int(np.argmin(distance))
    around = np.linalg.norm(samples.points - samples.points[nearest], axis=1) < _AROUND_M
    facing = samples.normals @ samples.normals[nearest] > 0.5
    mean = samples.normals[around & facing].sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _axes(
    normal: NDArray[np.float64], to_middle: NDArray[np.float64], long_axis: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Site axes as columns: z along `normal`, y along the face's long axis and away from the middle of the bone.

    The body of the scapula lies below the glenoid, so superior is away from the middle of its surface.
    """
    away = -(to_middle - (to_middle @ normal) * normal)
    if long_axis is not None:
        y = long_axis - (long_axis @ normal) * normal
        y = y if y @ away >= 0.0 else -y
    elif np.linalg.norm(away) > 1e-6:
        y = away
    else:
        y = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    y = y / np.linalg.norm(y)
    return np.column_stack([np.cross(y, normal), y, normal])


def _on_surface(surface: Surface, centre: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Point where the axis through `centre` leaves the bone, the nearest such within 10 mm."""
    points = (surface.vertices_m - centre) @ rotation
    found = column_crossings(points, surface.faces, np.array([1e-9]), np.array([1e-9]))
    leaving = found.height[found.entering < 0]
    nearest = float(leaving[np.argmin(np.abs(leaving))]) if len(leaving) else np.inf
    if abs(nearest) > _FARTHEST_M:
        vertex = surface.vertices_m[np.argmin(np.linalg.norm(surface.vertices_m - centre, axis=1))]
        given, corner = (in_brackets(1e3 * point, ".4g") for point in (centre, vertex))
        raise InputError(
            f"anatomy.centre_mm must lie within 10 mm of the surface along the normal, got {given} in "
            f"{surface.report.source}: give a point on the face, in mm in the frame of the file; the nearest corner is "
            f"{corner}"
        )
    return centre + nearest * rotation[:, 2]


def _size(face: Face) -> str:
    return f"{1e3 * face.width_m:.1f} x {1e3 * face.length_m:.1f} mm"
