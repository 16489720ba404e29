"""Tetrahedral meshes: files, filling of surfaces, quality and repair."""
