"""A bone surface as an anatomy with the density of a CT: layers by density and depth."""

from pathlib import Path

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import InputError, require_ranges
from meshes.images.frame import Image
from meshes.images.itk import header_lines
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import TriangleSampler, triangle_distance

__all__ = ["CORTICAL_ABOVE_KG_M3", "IMAGED_LAYERS", "LAW", "imaged_anatomy", "stated_law"]

IMAGED_LAYERS = ("cortical", "subchondral", "trabecular")
LAW = "density_law"
"""Key of an image's header that states where its densities come from and how sure they are."""
CORTICAL_ABOVE_KG_M3 = 1000.0
"""Apparent density from which bone is cortical: ash density 0.6 g/cm3, where Keyak (1998) changes from trabecular to
cortical, over ash to apparent 0.598 (Schileo 2008)."""
_LEAST_KG_M3 = 50.0
_PLATE_M = 5e-3
"""Greatest depth of a subchondral plate: 1.2 to 2.9 mm on the glenoid (Frich), more where a joint is loaded."""
_LEAST_COVERED = 0.99
_TO_EDGE = 0.501
"""Voxels from the centre of an image's last voxel to its edge, where a bone is cut off, with what rounding adds."""


def imaged_anatomy(
    surface: Surface,
    site: Site,
    density: Image,
    *,
    cortical_above_kg_m3: float = CORTICAL_ABOVE_KG_M3,
    articular_radius_mm: float = 0.0,
) -> Anatomy:
    """Anatomy of a bone in the site frame, its density interpolated in an image.

    Dense bone is cortical; within 5 mm under an articular face it is the subchondral plate; the rest is trabecular.

    Parameters
    ----------
    surface
        The bone's surface in the frame of the image [m].
    density
        Apparent density [kg/m3]; it has to go on for a voxel beyond the surface.
    cortical_above_kg_m3
        Density from which bone is cortical, 300 to 2000 kg/m3.
    articular_radius_mm
        Distance from the site across its normal within which the surface is a joint's [mm], 0 for none.

    Raises
    ------
    InputError
        If the image does not cover the surface, or a parameter is out of range.
    """
    dense, articular = require_ranges(
        ("cortical_above_kg_m3", cortical_above_kg_m3, 300.0, 2000.0, "use 1000"),
        ("articular_radius_mm", articular_radius_mm, 0.0, 100.0, "use 18 for a glenoid, 0 for no joint"),
    )
    _require_covered(surface, density)
    values = density.values.astype(np.float32)
    origin, spacing = 1e-3 * np.array(density.origin_mm), 1e-3 * np.array(density.spacing_mm)
    vertices, faces = site.to_site(surface.vertices_m), surface.faces
    to_voxels = (site.rotation / spacing[:, None]).astype(np.float32)
    first = ((site.centre_m - origin) / spacing).astype(np.float32)

    def distance(points: Floats) -> Floats:
        return triangle_distance(vertices, faces, points).astype(points.dtype)

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Layer and density [kg/m3] of points [m], shape (n, 3), at depths below the surface [m], shape (n,)."""
        from scipy.ndimage import map_coordinates

        at = to_voxels @ np.asarray(points, dtype=np.float32).T + first[:, None]
        found = np.maximum(map_coordinates(values, at, order=1, mode="nearest"), np.float32(_LEAST_KG_M3))
        layer = np.where(found >= dense, np.uint8(0), np.uint8(2))
        if articular > 0.0:
            aside = np.hypot(points[:, 0], points[:, 1]) < 1e-3 * articular
            layer[(layer == 0) & aside & (depth < _PLATE_M)] = 1
        return layer, found

    notes = {
        "surface": surface.report.source,
        "unit": surface.report.unit_guess,
        "site": site.confidence,
        "repairs": " ".join(surface.report.repairs) or "none",
        "density": f"{density.source}: {values[values > 0].min():.0f} to {values.max():.0f} kg/m3, cortical from "
        f"{dense:g} kg/m3",
    }
    solid = Shape(distance, tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist()))
    threshold = _PLATE_M if articular > 0.0 else 0.0
    sampler, placement = TriangleSampler(vertices, faces, threshold), site.placement(surface.report.scale_mm)
    caps = tuple(site.to_site(points) for points in surface.caps_m)
    return Anatomy(surface.report.source, solid, IMAGED_LAYERS, classify, notes, sampler, placement, caps)


def stated_law(path: Path) -> str:
    """What the header of an image of densities states of their law; nothing where it states none."""
    if not path.name.lower().endswith((".nrrd", ".nhdr")):
        return ""
    return header_lines(path, ":", "")[0].get(LAW, "").removeprefix("=").strip()


def _require_covered(surface: Surface, density: Image) -> None:
    """Refuse an image that holds nothing at the surface: another bone, another frame or another unit."""
    origin, spacing = np.array(density.origin_mm), np.array(density.spacing_mm)
    last = np.array(density.values.shape) - 1
    at = (1e3 * surface.vertices_m - origin) / spacing
    inside = ((at > -_TO_EDGE) & (at < last + _TO_EDGE)).all(axis=1)
    there = density.values[tuple(np.rint(at[inside]).astype(np.int64).clip(0, last).T)] > 0
    covered = float(there.sum() / len(at))
    if covered < _LEAST_COVERED:
        raise InputError(
            f"density_file must hold the density of the bone up to its surface, got none at {1 - covered:.0%} of the "
            f"surface of {surface.report.source} in {density.source}: give both in one frame (LPS, mm)"
        )
    if not np.isfinite(density.values).all() or density.values.min() < 0 or density.values.max() > 20_000:
        raise InputError(
            f"density_file must hold apparent densities from 0 to 20000 kg/m3, got {density.values.min():g} to "
            f"{density.values.max():g} in {density.source}: convert Hounsfield units by `tissue import`"
        )
