"""Real haptic devices: one adapter a file, the workspace that they are mapped to, and what is
found on this machine.
"""
