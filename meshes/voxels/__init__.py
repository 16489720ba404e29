"""Voxel grids, and their filling."""
