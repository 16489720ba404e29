"""Haptic devices, models of the hand, stability of the haptic loop, and force rendering."""
