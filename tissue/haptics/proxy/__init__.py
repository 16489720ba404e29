"""Virtual coupling of a tool to a haptic device, and proxy (god-object) of a tool in contact."""
