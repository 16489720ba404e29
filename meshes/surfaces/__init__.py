"""Triangle surfaces: reading, repair, and sites on surfaces."""
