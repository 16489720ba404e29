"""Real haptic devices: adapters, workspace mapping, and search for connected devices."""
