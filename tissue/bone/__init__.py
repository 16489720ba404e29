"""Bone: voxels that a cutter removes."""

from tissue.bone.bricks import BrickStore
from tissue.bone.model import BoneModel, Removal

__all__ = ["BoneModel", "BrickStore", "Removal"]
