"""Conversion of a user's CT to a scene.

The conversion inspects the image, extracts a bone with its density or an organ, finds a site,
imports a path, and writes a folder that can be simulated.
"""
