"""Tool paths from files, functions for polylines, and depth of a path below a bone's surface."""
