"""Time of a tick and force error of every setting of a scene, measured on this machine."""
