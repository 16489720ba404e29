"""Reference cutting force on the exact geometry, without the voxels and elements of the engine."""
