"""Bone as voxels that a cutter removes."""
