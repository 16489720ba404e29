"""Geometry: signed distances, anatomy, voxels, surfaces and images, without physics and Warp.

This package provides the geometry that a scene needs. Basic shapes are in `meshes.shapes.sdf`.
Lengths are in metres unless a name states another unit. Modules that read files or search surfaces
import pyvista, trimesh and scikit-image when their functions are called. The public names of the
package are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from meshes.base.errors import InputError
    from meshes.base.placement import Placement
    from meshes.ct.density import CT_DENSITY, DensityLaw
    from meshes.images.bone_image import image_volume
    from meshes.images.reading import read_image
    from meshes.shapes.anatomy import Anatomy, cortical_block
    from meshes.shapes.sdf import Shape
    from meshes.surfaces.glenoid import glenoid, surface_anatomy
    from meshes.surfaces.landmarks import find_glenoid
    from meshes.surfaces.site import Site, place_site
    from meshes.surfaces.surface import Surface, SurfaceReport, read_surface
    from meshes.tooth.label_volume import labelled_tooth
    from meshes.tooth.layered_surfaces import layered_surfaces
    from meshes.tooth.layers import TOOTH_LAYERS, caries_softness
    from meshes.tooth.molar import molar
    from meshes.voxels.volume import VoxelVolume
    from meshes.voxels.voxelise import voxelise

__all__ = [
    "CT_DENSITY",
    "TOOTH_LAYERS",
    "Anatomy",
    "DensityLaw",
    "InputError",
    "Placement",
    "Shape",
    "Site",
    "Surface",
    "SurfaceReport",
    "VoxelVolume",
    "caries_softness",
    "cortical_block",
    "find_glenoid",
    "glenoid",
    "image_volume",
    "labelled_tooth",
    "layered_surfaces",
    "molar",
    "place_site",
    "read_image",
    "read_surface",
    "surface_anatomy",
    "voxelise",
]

_HOMES = {
    "Anatomy": "meshes.shapes.anatomy",
    "CT_DENSITY": "meshes.ct.density",
    "DensityLaw": "meshes.ct.density",
    "InputError": "meshes.base.errors",
    "Placement": "meshes.base.placement",
    "Shape": "meshes.shapes.sdf",
    "Site": "meshes.surfaces.site",
    "Surface": "meshes.surfaces.surface",
    "SurfaceReport": "meshes.surfaces.surface",
    "TOOTH_LAYERS": "meshes.tooth.layers",
    "VoxelVolume": "meshes.voxels.volume",
    "caries_softness": "meshes.tooth.layers",
    "cortical_block": "meshes.shapes.anatomy",
    "find_glenoid": "meshes.surfaces.landmarks",
    "glenoid": "meshes.surfaces.glenoid",
    "image_volume": "meshes.images.bone_image",
    "labelled_tooth": "meshes.tooth.label_volume",
    "layered_surfaces": "meshes.tooth.layered_surfaces",
    "molar": "meshes.tooth.molar",
    "place_site": "meshes.surfaces.site",
    "read_image": "meshes.images.reading",
    "read_surface": "meshes.surfaces.surface",
    "surface_anatomy": "meshes.surfaces.glenoid",
    "voxelise": "meshes.voxels.voxelise",
}
"""Dictionary from each public name to the module that defines this name."""


def __getattr__(name: str) -> Any:
    """Import a name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
