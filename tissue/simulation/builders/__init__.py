"""Names of a scene become objects."""
