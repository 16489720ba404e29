"""Sampled loop of a device and a hand: filters, delays, vibration, stability and passivity."""
