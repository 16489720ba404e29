"""Bone: voxels that a cutter removes."""

from tissue.bone.bricks import BrickStore
from tissue.bone.carver import Removal
from tissue.bone.model import BoneModel
from tissue.bone.replay import CarvingReplay

__all__ = ["BoneModel", "BrickStore", "CarvingReplay", "Removal"]
