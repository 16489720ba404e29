"""Builders that turn the names in a scene into objects."""
