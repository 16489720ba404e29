"""Conversion of a user's CT to a scene.

The conversion inspects the image and extracts an organ, or a bone with its density. It then finds
the site where the tool works, imports a toolpath, and writes a folder that can be simulated.
"""
