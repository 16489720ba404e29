"""Conversion of a user's CT to a scene.

It covers inspection of the image, the bone with its density, a site, a path, and a folder to run.
"""
