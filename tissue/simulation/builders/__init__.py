"""Builders that make objects from the names and values in a scene."""
