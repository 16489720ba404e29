"""Simulated hands."""
