"""Procedural soft organs."""
