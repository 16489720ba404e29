"""Triangle surfaces: reading, repair, and search for sites where a tool works."""
