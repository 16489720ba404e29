"""Tetrahedral meshes: files, meshing of closed surfaces, quality and repair."""
