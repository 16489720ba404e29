"""Triangle surfaces: files, repair, sites on them."""
