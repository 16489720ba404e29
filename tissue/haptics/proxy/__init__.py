"""Proxy of a tool on the voxel map, and its virtual coupling to the device."""
