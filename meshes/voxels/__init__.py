"""Grids of voxels and their filling."""
