"""The proxy on the voxel map and the virtual coupling to it."""
