"""Procedural lumbar vertebra."""
