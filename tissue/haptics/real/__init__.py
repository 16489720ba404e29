"""Real haptic devices: adapters, mapping of the workspace, and search for connected devices."""
