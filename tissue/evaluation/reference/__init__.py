"""Reference of the cutting force on exact geometry, without voxels and elements of the engine."""
