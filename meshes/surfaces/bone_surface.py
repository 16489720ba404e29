"""A bone surface as an anatomy: a cortical shell of even thickness over trabecular bone."""

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import require_ranges
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import TriangleSampler, triangle_distance

__all__ = ["SURFACE_LAYERS", "surface_anatomy"]

SURFACE_LAYERS = ("cortical", "trabecular")


def surface_anatomy(
    surface: Surface,
    site: Site,
    *,
    cortical_thickness_mm: float = 1.9,
    cortical_density_kg_m3: float = 1800.0,
    trabecular_density_kg_m3: float = 350.0,
) -> Anatomy:
    """Build the anatomy of a bone surface in the site frame.

    It is a cortical shell of even thickness over trabecular bone. A surface holds no information on
    the inside: thickness and densities are assumptions, recorded in the notes. The default
    thickness is the mean of the subchondral plate (1.2-2.9 mm, six glenoids, Frich). Densities are
    as in `meshes.surfaces.glenoid`.

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
    thickness, dense, sparse = require_ranges(
        ("cortical_thickness_mm", cortical_thickness_mm, 0.0, 10.0, "use 1.9"),
        ("cortical_density_kg_m3", cortical_density_kg_m3, 50.0, 2500.0, "use 1800"),
        ("trabecular_density_kg_m3", trabecular_density_kg_m3, 50.0, 2500.0, "use 350"),
    )
    shell = 1e-3 * thickness
    vertices = site.to_site(surface.vertices_m)
    faces = surface.faces

    def distance(points: Floats) -> Floats:
        return triangle_distance(vertices, faces, points).astype(points.dtype)

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        layer = (depth >= shell).astype(np.uint8)
        return layer, np.where(layer == 0, np.float32(dense), np.float32(sparse))

    notes = {
        "surface": surface.report.source,
        "unit": surface.report.unit_guess,
        "site": site.confidence,
        "repairs": " ".join(surface.report.repairs) or "none",
        "cortical shell": f"{cortical_thickness_mm:g} mm of {dense:g} kg/m3 over {sparse:g} "
        "kg/m3, assumed: "
        "the file "
        "holds a surface only",
    }
    solid = Shape(
        distance, tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist())
    )
    sampler = TriangleSampler(vertices, faces, shell)
    placement = site.placement(surface.report.scale_mm)
    caps = tuple(site.to_site(points) for points in surface.caps_m)
    return Anatomy(
        surface.report.source, solid, SURFACE_LAYERS, classify, notes, sampler, placement, caps
    )
