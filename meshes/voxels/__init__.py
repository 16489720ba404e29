"""Grids of voxels and how they are filled."""
