"""Paths of tools from files, polylines, and depth below a bone's surface."""
