"""Paths of tools from files, and their depth below a bone's surface."""
