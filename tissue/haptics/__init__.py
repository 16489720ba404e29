"""Haptic devices, simulated hands, stability of the haptic loop, and force rendering."""
