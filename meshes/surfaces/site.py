"""The working site on a bone surface: its centre and its axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.placement import Placement
from meshes.surfaces.glenoid_search import Face, SurfaceSamples, best_seed, grow_face, sample_surface
from meshes.surfaces.surface import Surface
from meshes.voxels.column_crossings import column_crossings

__all__ = ["Site", "axes_along", "find_glenoid", "place_site"]

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

    def to_site(self, points_m: NDArray[Any]) -> NDArray[np.float64]:
        """Points [m], shape (n, 3), from the surface's frame to the site frame."""
        return (np.asarray(points_m, dtype=np.float64) - self.centre_m) @ self.rotation

    def within(self, outer: Placement) -> Site:
        """The same site in the frame of the file in which the frame of this one is placed."""
        centre = 1e-3 * outer.origin_mm + outer.rotation @ self.centre_m
        return Site(centre, outer.rotation @ self.rotation, self.confidence)

    def placement(self, unit_mm: float) -> Placement:
        """Where the site lies in a file with units of that length [mm]."""
        return Placement(1e3 * self.centre_m, self.rotation, unit_mm)


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
        return _face_at(surface, _three("anatomy.centre_mm", centre_mm) * 1e-3, along)
    point, normal, score = best_seed(sample_surface(*surface.scanned, _SAMPLES))
    samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
    face = grow_face(samples, point, normal)
    plausible = _WIDTH_M[0] <= face.width_m <= _WIDTH_M[1] and _LENGTH_M[0] <= face.length_m <= _LENGTH_M[1]
    if score < _LEAST_SCORE or not plausible:
        raise InputError(
            f"file must show a glenoid of about 28 x 37 mm, got none in {surface.report.source} (best "
            "face "
            f"{_size(face)}, score {score:.2f}): check anatomy.scale_mm, or give anatomy.centre_mm and "
            "anatomy.normal"
        )
    if along is None:
        rotation = _axes(face.normal, samples.points.mean(axis=0) - face.centre_m, face.long_axis)
    else:
        rotation = axes_along(face.normal, along)
    radius = face.curvature_radius_m
    bend = "concave" if radius > 0.0 else "convex"
    shape = "flat" if abs(radius) > _FLAT_M else f"{bend}, radius {1e3 * abs(radius):.0f} mm"
    note = f"found by search: face {_size(face)}, {shape}, score {score:.2f} of 1; check it in the picture"
    return Site(_on_surface(surface, face.centre_m, rotation, _FARTHEST_M), rotation, note)


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
    centre = _three("anatomy.centre_mm", centre_mm) * 1e-3
    if normal is None:
        samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
        axis, note = _normal_near(samples, centre), "centre as given, normal of the surface around it"
    else:
        axis, note = _direction("anatomy.normal", normal, "the outward direction"), "centre and normal as given"
    if along is None:
        samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
        rotation = _axes(axis, samples.points.mean(axis=0) - centre, None)
    else:
        rotation, note = axes_along(axis, along), note + ", x along the direction given"
    return Site(_on_surface(surface, centre, rotation, _FARTHEST_M), rotation, note)


def _face_at(surface: Surface, centre: NDArray[np.float64], along: Sequence[float] | None) -> Site:
    """Site with the normal of the face around its centre."""
    samples = sample_surface(*surface.scanned, _FACE_SAMPLES)
    near = int(np.argmin(np.linalg.norm(samples.points - centre, axis=1)))
    normal = grow_face(samples, samples.points[near], samples.normals[near]).normal
    rotation = _axes(normal, samples.points.mean(axis=0) - centre, None) if along is None else axes_along(normal, along)
    note = "centre as given, normal of the face around it"
    return Site(_on_surface(surface, centre, rotation, _FARTHEST_M), rotation, note)


def axes_along(normal: NDArray[np.float64], along: Sequence[float]) -> NDArray[np.float64]:
    """Axes as columns, shape (3, 3): z the unit vector `normal`, x as close to the direction `along` as it can be.

    Raises
    ------
    InputError
        If `along` is zero or within a degree of the normal.
    """
    direction = _direction("anatomy.along", along, "a direction across the normal")
    across = direction - (direction @ normal) * normal
    if np.linalg.norm(across) < _LEAST_ACROSS:
        raise InputError(
            f"anatomy.along must lead across the normal {_text(normal)}, got {_text(direction)}: give a direction in "
            "the plane of the site"
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


def _on_surface(
    surface: Surface, centre: NDArray[np.float64], rotation: NDArray[np.float64], farthest: float
) -> NDArray[np.float64]:
    """Point where the axis through `centre` leaves the bone, the nearest such within `farthest` [m]."""
    points = (surface.vertices_m - centre) @ rotation
    found = column_crossings(points, surface.faces, np.array([1e-9]), np.array([1e-9]))
    leaving = found.height[found.entering < 0]
    nearest = float(leaving[np.argmin(np.abs(leaving))]) if len(leaving) else np.inf
    if abs(nearest) > farthest:
        points = surface.vertices_m
        vertex = 1e3 * points[np.argmin(np.linalg.norm(points - centre, axis=1))]
        raise InputError(
            f"anatomy.centre_mm must lie within 10 mm of the surface along the normal, got {_text(1e3 * centre)} in "
            f"{surface.report.source}: give a point on the face, in mm in the frame of the file; the nearest corner is "
            f"{_text(vertex)}"
        )
    return centre + nearest * rotation[:, 2]


def _three(name: str, value: Sequence[float]) -> NDArray[np.float64]:
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} must be three finite numbers, got {value}: use for example (0, 0, 1)")
    return vector


def _direction(name: str, value: Sequence[float], remedy: str) -> NDArray[np.float64]:
    """Unit vector along a direction that a person gave."""
    vector = _three(name, value)
    if not np.linalg.norm(vector) > 0.0:
        raise InputError(f"{name} must not be zero, got (0, 0, 0): give {remedy}")
    return np.asarray(vector / np.linalg.norm(vector))


def _size(face: Face) -> str:
    return f"{1e3 * face.width_m:.1f} x {1e3 * face.length_m:.1f} mm"


def _text(vector: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in vector) + ")"
