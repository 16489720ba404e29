"""Anatomies of bones whose interior is known.

The interior is known from the densities in a CT image, or from a second surface around the
trabecular bone.
"""

from pathlib import Path

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import InputError, require_ranges
from meshes.images.frame import Image
from meshes.images.text_headers import header_lines
from meshes.shapes.anatomy import CORTICAL_KG_M3, TRABECULAR_KG_M3, Anatomy
from meshes.surfaces.glenoid import SURFACE_LAYERS, sampled_anatomy
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.tooth.layered_surfaces import joined
from meshes.voxels.mesh_sampling import TriangleSampler, inside_scattered, triangle_distance

IMAGED_LAYERS = ("cortical", "subchondral", "trabecular")
LAW = "density_law"
"""Key in the header of a density image for the source and uncertainty of the densities."""
CORTICAL_ABOVE_KG_M3 = 1000.0
"""Apparent density above which bone is cortical.

Keyak (1998) changes from trabecular to cortical bone at an ash density of 0.6 g/cm3. The constant
is this ash density divided by 0.598, the ratio of ash to apparent density (Schileo 2008).
"""
_LEAST_KG_M3 = 50.0
"""Lowest density of bone [kg/m3], equal to the lower limit in `DensityLaw`.

Interpolation between bone and voxels without bone would give lower densities.
"""
_PLATE_M = 5e-3
"""Largest depth [m] of a subchondral plate below the joint surface.

The plate is 1.2 to 2.9 mm thick on the glenoid (Frich), and thicker where a joint is loaded.
"""
_LEAST_COVERED = 0.99
"""Smallest valid share of surface points at which the density image contains a density."""
_TO_EDGE = 0.501
"""Distance [voxel] from the centre of the last voxel to the edge of the image, with a tolerance.

A bone may be cut off at this edge.
"""
_FARTHEST_OUT_M = 0.5e-3
"""Distance [m] from the bone up to which a point of the trabecular core counts as touching.

The value is not zero, because the surfaces of core and bone are smoothed separately.
"""
_LEAST_TOUCHING = 0.2
"""Smallest valid share of a trabecular core's points that touch the bone.

The share is small, because a surface of the cortex alone may be open, for example at the teeth of a
jaw. The core then lies outside the solid that this surface encloses.
"""


def imaged_anatomy(
    surface: Surface,
    site: Site,
    density: Image,
    *,
    cortical_above_kg_m3: float = CORTICAL_ABOVE_KG_M3,
    articular_radius_mm: float = 0.0,
) -> Anatomy:
    """Return the anatomy of a bone in the site frame, with densities interpolated from an image.

    Dense bone is cortical. Dense bone at most 5 mm below an articular face is the subchondral plate
    instead. Bone of lower density is trabecular.

    Parameters
    ----------
    surface
        Surface of the bone [m], in the frame of the image.
    density
        Apparent density [kg/m3]. It must extend to at least one voxel outside the surface.
    cortical_above_kg_m3
        Density above which bone is cortical, 300 to 2000 kg/m3.
    articular_radius_mm
        Radius [mm] of the joint surface around the site, measured perpendicular to the site's
        normal; 0 if there is no joint.

    Raises
    ------
    InputError
        If the image does not cover the surface or contains values that are not densities, or if a
        parameter is out of range.
    """
    dense, articular = require_ranges(
        # The default density of trabecular bone is 350 kg/m3, and the densest cortex has 2000
        # kg/m3.
        ("cortical_above_kg_m3", cortical_above_kg_m3, 300.0, 2000.0, "use a value such as 1000"),
        (
            # A radius of 100 mm or more is the whole bone. The radius of a glenoid is about 18 mm.
            "articular_radius_mm",
            articular_radius_mm,
            0.0,
            100.0,
            "use 18 for a glenoid, 0 for no joint",
        ),
    )
    _require_covered(surface, density)
    values = density.values.astype(np.float32)
    origin = 1e-3 * np.array(density.origin_mm)
    spacing = 1e-3 * np.array(density.spacing_mm)
    to_voxels = (site.rotation / spacing[:, None]).astype(np.float32)
    first = ((site.centre_m - origin) / spacing).astype(np.float32)

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return the layers and densities [kg/m3] of points at depths below the surface.

        The points [m] have the shape (n, 3), and the depths [m] have the shape (n,).
        """
        from scipy.ndimage import map_coordinates

        at = to_voxels @ np.asarray(points, dtype=np.float32).T + first[:, None]
        found = np.maximum(
            map_coordinates(values, at, order=1, mode="nearest"), np.float32(_LEAST_KG_M3)
        )
        layer = np.where(found >= dense, np.uint8(0), np.uint8(2))
        if articular > 0.0:
            aside = np.hypot(points[:, 0], points[:, 1]) < 1e-3 * articular
            layer[(layer == 0) & aside & (depth < _PLATE_M)] = 1
        return layer, found

    notes = {
        "density": f"{density.source}: {values[values > 0].min():.0f} to {values.max():.0f} kg/m3, "
        "cortical from "
        f"{dense:g} kg/m3",
    }
    triangles = site.to_site(surface.vertices_m), surface.faces
    threshold = _PLATE_M if articular > 0.0 else 0.0
    return sampled_anatomy(
        surface, site, TriangleSampler(*triangles, threshold), IMAGED_LAYERS, classify, notes
    )


def cored_anatomy(
    surface: Surface,
    core: Surface,
    site: Site,
) -> Anatomy:
    """Return the anatomy of a bone in the site frame.

    The bone is trabecular within the surface `core` and cortical elsewhere.

    Parameters
    ----------
    surface
        Outer surface of the bone, or surface of the cortical bone alone. The surface of the
        cortical bone includes the inner surface around the core.
    core
        Surface around the trabecular bone, in the frame of `surface`.

    Raises
    ------
    InputError
        If the core lies outside the bone.
    """
    _require_within(surface, core)
    inner = site.to_site(core.vertices_m), core.faces
    whole = joined([(site.to_site(surface.vertices_m), surface.faces), inner])

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        layer = inside_scattered(*inner, points).astype(np.uint8)
        return layer, np.where(layer == 0, np.float32(CORTICAL_KG_M3), np.float32(TRABECULAR_KG_M3))

    notes = {
        "surface": f"{surface.report.source} around {core.report.source}",
        "repairs": " ".join((*surface.report.repairs, *core.report.repairs)) or "none",
        "densities": (
            f"cortical {CORTICAL_KG_M3:g}, trabecular {TRABECULAR_KG_M3:g} kg/m3, assumed: the "
            "files hold surfaces only"
        ),
    }
    sampler = TriangleSampler(*whole, 0.0)
    return sampled_anatomy(surface, site, sampler, SURFACE_LAYERS, classify, notes)


def stated_law(path: Path) -> str:
    """Return the density law stated in the header of a density image, or an empty string."""
    if not path.name.lower().endswith((".nrrd", ".nhdr")):
        return ""
    # In NRRD files, := separates a user-defined key from its value, so the value begins with =.
    return header_lines(path, ":", "")[0].get(LAW, "").removeprefix("=").strip()


def _require_covered(surface: Surface, density: Image) -> None:
    """Raise an error for a density image without density at the surface of the bone.

    Such an image belongs to another bone, or has another frame or unit. Also raise an error for
    values that are not densities, such as Hounsfield units.
    """
    origin = np.array(density.origin_mm)
    last = np.array(density.values.shape) - 1
    at = (1e3 * surface.vertices_m - origin) / density.spacing_mm
    inside = ((at > -_TO_EDGE) & (at < last + _TO_EDGE)).all(axis=1)
    there = density.values[tuple(np.rint(at[inside]).astype(np.int64).clip(0, last).T)] > 0
    covered = float(there.sum() / len(at))
    if covered < _LEAST_COVERED:
        raise InputError(
            "density_file",
            "contain the density of the bone up to its surface",
            (
                f"no density at {1 - covered:.0%} of the surface of {surface.report.source} in "
                f"{density.source}"
            ),
            "give both files in the same frame (LPS, mm)",
        )
    # Negative values are Hounsfield units of air. No implant is denser than gold with 19,300 kg/m3.
    if (
        not np.isfinite(density.values).all()
        or density.values.min() < 0
        or density.values.max() > 20_000
    ):
        raise InputError(
            "density_file",
            "contain apparent densities from 0 to 20000 kg/m3",
            f"{density.values.min():g} to {density.values.max():g} in {density.source}",
            "convert Hounsfield units with `tissue import`",
        )


def _require_within(surface: Surface, core: Surface) -> None:
    """Raise an error for a core that lies outside the bone.

    Such a core belongs to another bone, or has another frame or unit.
    """
    # With 2000 points, the standard error of a share of 0.2 is 0.01.
    points = core.vertices_m[:: max(len(core.vertices_m) // 2000, 1)]
    away = triangle_distance(surface.vertices_m, surface.faces, points)
    touching = float((away <= _FARTHEST_OUT_M).mean())
    if touching < _LEAST_TOUCHING:
        raise InputError(
            "core_file",
            "lie within anatomy.file",
            f"{1.0 - touching:.0%} of {core.report.source} outside {surface.report.source}",
            "give both files in the same frame and unit",
        )
