"""A tooth as voxels that a cutter removes, with stress and heat on particles."""
