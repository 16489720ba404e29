"""A bone of two surfaces: cortical bone around a core of trabecular bone, as segmentations give them."""

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import InputError, require_ranges
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.surfaces.bone_surface import SURFACE_LAYERS
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.tooth.layer_contact import inside_surface
from meshes.tooth.layered_solid import joined
from meshes.voxels.mesh_sampling import TriangleSampler, triangle_distance

__all__ = ["cored_anatomy"]

_FARTHEST_OUT_M = 0.5e-3
"""How far a core may reach out of the bone: surfaces that were smoothed apart."""
_LEAST_TOUCHING = 0.2
"""Share of a core's points that must lie in the bone or on it: a hollow cortex may be open, as a jaw's to its teeth."""


def cored_anatomy(
    surface: Surface,
    core: Surface,
    site: Site,
    *,
    cortical_density_kg_m3: float = 1800.0,
    trabecular_density_kg_m3: float = 350.0,
) -> Anatomy:
    """Anatomy of a bone in the site frame: trabecular within the core, cortical elsewhere.

    Parameters
    ----------
    surface
        Around the whole bone, or around the cortical bone alone, which is then hollow where the core is.
    core
        Around the trabecular bone, in the same frame.
    cortical_density_kg_m3, trabecular_density_kg_m3
        Apparent densities [kg/m3], 50 to 2500.

    Raises
    ------
    InputError
        If the core lies outside the bone, or a density is out of range.
    """
    dense, sparse = require_ranges(
        ("cortical_density_kg_m3", cortical_density_kg_m3, 50.0, 2500.0, "use 1800"),
        ("trabecular_density_kg_m3", trabecular_density_kg_m3, 50.0, 2500.0, "use 350"),
    )
    _require_within(surface, core)
    inner = site.to_site(core.vertices_m), core.faces
    vertices, faces = joined([(site.to_site(surface.vertices_m), surface.faces), inner])

    def distance(points: Floats) -> Floats:
        return triangle_distance(vertices, faces, points).astype(points.dtype)

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        layer = inside_surface(*inner, points).astype(np.uint8)
        return layer, np.where(layer == 0, np.float32(dense), np.float32(sparse))

    notes = {
        "surface": f"{surface.report.source} around {core.report.source}",
        "unit": surface.report.unit_guess,
        "site": site.confidence,
        "repairs": " ".join((*surface.report.repairs, *core.report.repairs)) or "none",
        "densities": f"cortical {dense:g}, trabecular {sparse:g} kg/m3, assumed: the files hold surfaces only",
    }
    solid = Shape(distance, tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist()))
    sampler = TriangleSampler(vertices, faces, 0.0)
    caps = tuple(site.to_site(points) for points in surface.caps_m)
    placement = site.placement(surface.report.scale_mm)
    return Anatomy(surface.report.source, solid, SURFACE_LAYERS, classify, notes, sampler, placement, caps)


def _require_within(surface: Surface, core: Surface) -> None:
    """Refuse a core that lies elsewhere: another bone, frame or unit."""
    points = core.vertices_m[:: max(len(core.vertices_m) // 2000, 1)]
    away = triangle_distance(surface.vertices_m, surface.faces, points)
    touching = float((away <= _FARTHEST_OUT_M).mean())
    if touching < _LEAST_TOUCHING:
        raise InputError(
            f"core_file must lie within anatomy.file, got {1.0 - touching:.0%} of {core.report.source} outside "
            f"{surface.report.source}: give both in one frame and unit"
        )
