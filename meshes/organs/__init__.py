"""Soft organs, procedural or from labels."""
