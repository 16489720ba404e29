"""Cited material constants."""
