"""A person's own CT to a scene: what it holds, the bone with its density, a site, a path, and a
folder to run.
"""
