"""Reference cutting force on the exact geometry, without voxels and surface elements."""
