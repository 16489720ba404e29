"""Paths of tools from files, and how deep below a bone's surface they lead."""
