"""Warp kernels: arrays in, arrays out. They know neither scenes nor meshes."""
