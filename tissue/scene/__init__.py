"""Scenes: validated descriptions of simulations, read from TOML files."""
