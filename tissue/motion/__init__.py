"""Motions of a tool (paths, thrust force, recorded poses), and rotations."""
