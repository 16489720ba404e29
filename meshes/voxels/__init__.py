"""Voxel grids, and functions that fill them from an anatomy."""
