"""Scenes: the validated description of what to simulate, read from TOML."""
