"""Tool paths from files, polylines, and depth below a bone's surface."""
