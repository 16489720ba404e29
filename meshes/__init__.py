"""Geometry: signed distances, anatomy, voxels, surfaces and images. No physics, no Warp."""

from meshes.anatomy import Anatomy, cortical_block
from meshes.errors import InputError
from meshes.glenoid import glenoid
from meshes.sdf import Shape
from meshes.volume import VoxelVolume
from meshes.voxelise import voxelise

__all__ = ["Anatomy", "InputError", "Shape", "VoxelVolume", "cortical_block", "glenoid", "voxelise"]
