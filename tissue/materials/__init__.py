"""Material constants with their sources."""
