"""A tooth as voxels that a cutter removes, with stress by particle finite elements."""
