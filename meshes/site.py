"""The working site on a bone surface: its centre, its axes, and the anatomy under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.anatomy import Anatomy
from meshes.errors import InputError, require_range
from meshes.glenoid_search import Face, best_seed, grow_face, sample_surface
from meshes.mesh_sampling import TriangleSampler, column_crossings, triangle_distance
from meshes.sdf import Shape
from meshes.surface import Surface

__all__ = ["SURFACE_LAYERS", "Site", "find_glenoid", "surface_anatomy"]

SURFACE_LAYERS = ("cortical", "trabecular")
_SAMPLES, _FACE_SAMPLES = 8000, 40000
_LEAST_SCORE = 0.25
_WIDTH_M, _LENGTH_M = (18e-3, 36e-3), (26e-3, 48e-3)
_FARTHEST_M = 10e-3
_FLAT_M = 0.2


@dataclass(frozen=True, eq=False)
class Site:
    """Where to work on a surface.

    Attributes
    ----------
    centre_m
        Point of the surface at the centre of the working face [m], in the surface's frame, shape (3,).
    rotation
        Site axes as columns in the surface's frame, shape (3, 3), right-handed: z outward, y superior, x anterior on a
        right scapula and posterior on a left one.
    confidence
        How it was found and how sure that is, a sentence.
    """

    centre_m: NDArray[np.float64]
    rotation: NDArray[np.float64]
    confidence: str

    def to_site(self, points_m: NDArray[Any]) -> NDArray[np.float64]:
        """Points [m], shape (n, 3), from the surface's frame to the site frame."""
        return (np.asarray(points_m, dtype=np.float64) - self.centre_m) @ self.rotation


def find_glenoid(
    surface: Surface, *, centre_mm: Sequence[float] | None = None, normal: Sequence[float] | None = None
) -> Site:
    """Find the glenoid's centre and outward axis, or take them as told.

    Parameters
    ----------
    surface
        A scapula, or any bone where centre and normal are given.
    centre_mm
        Centre of the face [mm] in the frame of the file after scaling; moved along the normal onto the surface. None:
        searched for.
    normal
        Outward direction there, any length. None with a centre: the normal of the face around the centre.

    Raises
    ------
    InputError
        If nothing on the surface looks like a glenoid, or the centre given is off the surface.
    """
    if centre_mm is None:
        if normal is not None:
            raise InputError(f"anatomy.centre_mm must be given with anatomy.normal, got none with {normal}: give both")
        return _searched(surface)
    centre = _three("anatomy.centre_mm", centre_mm) * 1e-3
    samples = sample_surface(surface.vertices_m, surface.faces, _FACE_SAMPLES)
    if normal is None:
        near = int(np.argmin(np.linalg.norm(samples.points - centre, axis=1)))
        face = grow_face(samples, samples.points[near], samples.normals[near])
        axis = face.normal
        said = "centre as told, normal of the face around it"
    else:
        axis = _three("anatomy.normal", normal)
        if not np.linalg.norm(axis) > 0.0:
            raise InputError("anatomy.normal must not be zero, got (0, 0, 0): give the outward direction")
        axis = axis / np.linalg.norm(axis)
        said = "centre and normal as told"
    rotation = _axes(axis, samples.points.mean(axis=0) - centre, None)
    return Site(_on_surface(surface, centre, rotation, _FARTHEST_M), rotation, said)


def surface_anatomy(
    surface: Surface,
    site: Site,
    *,
    cortical_thickness_mm: float = 1.9,
    cortical_density_kg_m3: float = 1800.0,
    trabecular_density_kg_m3: float = 350.0,
) -> Anatomy:
    """Anatomy of a bone surface in the site frame: a cortical shell of even thickness over trabecular bone.

    A surface says nothing of what is inside: thickness and densities are assumptions, recorded in the notes. The
    default thickness is the mean of the subchondral plate (1.2-2.9 mm, six glenoids, Frich); densities as in
    `meshes.glenoid`.

    Parameters
    ----------
    cortical_thickness_mm
        Thickness of the shell [mm], 0 (none) to 10.
    cortical_density_kg_m3, trabecular_density_kg_m3
        Apparent densities [kg/m3], 50 to 2500.

    Raises
    ------
    InputError
        If a parameter is not finite or out of range.
    """
    shell = 1e-3 * require_range("cortical_thickness_mm", cortical_thickness_mm, 0.0, 10.0, "use 1.9")
    dense = require_range("cortical_density_kg_m3", cortical_density_kg_m3, 50.0, 2500.0, "use 1800")
    sparse = require_range("trabecular_density_kg_m3", trabecular_density_kg_m3, 50.0, 2500.0, "use 350")
    vertices = site.to_site(surface.vertices_m)
    faces = surface.faces

    def distance(points: NDArray[Any]) -> NDArray[Any]:
        return triangle_distance(vertices, faces, points).astype(points.dtype)

    def classify(points: NDArray[Any], depth: NDArray[Any]) -> tuple[NDArray[np.uint8], NDArray[Any]]:
        layer = (depth >= shell).astype(np.uint8)
        return layer, np.where(layer == 0, np.float32(dense), np.float32(sparse))

    notes = {
        "surface": surface.report.source,
        "unit": surface.report.unit_guess,
        "site": site.confidence,
        "repairs": " ".join(surface.report.repairs) or "none",
        "cortical shell": f"{cortical_thickness_mm:g} mm, assumed: the file holds a surface only",
    }
    solid = Shape(distance, tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist()))
    return Anatomy(surface.report.source, solid, SURFACE_LAYERS, classify, notes, TriangleSampler(vertices, faces))


def _searched(surface: Surface) -> Site:
    """Site of the best-looking face, refused where it does not look like a glenoid."""
    point, normal, score = best_seed(sample_surface(surface.vertices_m, surface.faces, _SAMPLES))
    samples = sample_surface(surface.vertices_m, surface.faces, _FACE_SAMPLES)
    face = grow_face(samples, point, normal)
    plausible = _WIDTH_M[0] <= face.width_m <= _WIDTH_M[1] and _LENGTH_M[0] <= face.length_m <= _LENGTH_M[1]
    if score < _LEAST_SCORE or not plausible:
        raise InputError(
            f"file must show a glenoid of about 28 x 37 mm, got none in {surface.report.source} (best "
            "face "
            f"{_size(face)}, score {score:.2f}): check anatomy.scale_mm, or give anatomy.centre_mm and "
            "anatomy.normal"
        )
    rotation = _axes(face.normal, samples.points.mean(axis=0) - face.centre_m, face.long_axis)
    radius = face.curvature_radius_m
    bend = "concave" if radius > 0.0 else "convex"
    shape = "flat" if abs(radius) > _FLAT_M else f"{bend}, radius {1e3 * abs(radius):.0f} mm"
    said = f"found by search: face {_size(face)}, {shape}, score {score:.2f} of 1; check it in the picture"
    return Site(_on_surface(surface, face.centre_m, rotation, _FARTHEST_M), rotation, said)


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
        raise InputError(
            f"anatomy.centre_mm must lie within 10 mm of the surface along the normal, got "
            f"{_text(centre * 1e3)}"
            f" in {surface.report.source}: give a point on the face, in mm in the frame of the file"
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


def _size(face: Face) -> str:
    return f"{1e3 * face.width_m:.1f} x {1e3 * face.length_m:.1f} mm"


def _text(vector: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in vector) + ")"
