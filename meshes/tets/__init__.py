"""Tetrahedral meshes: files, filling, quality, repair."""
