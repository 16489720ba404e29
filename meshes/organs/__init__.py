"""Soft organs, procedural or from label images."""
