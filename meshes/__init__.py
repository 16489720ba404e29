"""Geometry: signed distances, anatomy, voxels, surfaces and images. No physics, no Warp.

Shapes live in `meshes.sdf`; everything else that a scene needs is named here. Lengths are in metres unless the name
says otherwise. Modules that read files or search surfaces import pyvista, trimesh and scikit-image when called.
"""

from meshes.anatomy import Anatomy, cortical_block
from meshes.errors import InputError
from meshes.glenoid import glenoid
from meshes.image import CT_DENSITY, DensityLaw, read_volume
from meshes.label_volume import label_volume
from meshes.layered_surfaces import layered_surfaces
from meshes.molar import molar
from meshes.placement import Placement
from meshes.sdf import Shape
from meshes.site import Site, find_glenoid, place_site
from meshes.surface import Surface, SurfaceReport, read_surface
from meshes.surface_anatomy import surface_anatomy
from meshes.tooth_layers import TOOTH_LAYERS, caries_softness
from meshes.volume import VoxelVolume
from meshes.voxelise import voxelise

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
    "label_volume",
    "layered_surfaces",
    "molar",
    "place_site",
    "read_surface",
    "read_volume",
    "surface_anatomy",
    "voxelise",
]
