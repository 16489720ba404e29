"""Motions of a tool (paths, thrust, recorded poses) and rotations."""
