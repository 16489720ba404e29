"""Geometry: signed distances, anatomy, voxels, surfaces and images. No physics, no Warp.

Shapes live in `meshes.shapes.sdf`; everything else that a scene needs is named here. Lengths are in
metres unless the name differs. Modules that read files or search surfaces import pyvista, trimesh
and scikit-image when called.
"""

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
