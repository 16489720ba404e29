"""Base of all geometry: errors, progress, cache, whole files, parsing in a child process."""
