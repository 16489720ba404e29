"""Basic functions for all geometry modules: errors, progress, cache, files, isolated parsing."""
