"""A tooth as voxels that a cutter removes, with stress on particles."""
