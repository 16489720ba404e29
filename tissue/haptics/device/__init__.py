"""Haptic devices: interface, published limits, safe operation, simulated and recorded devices."""
