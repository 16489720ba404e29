"""Basic functions of all geometry modules: errors, progress, cache, files, isolated parsing."""
