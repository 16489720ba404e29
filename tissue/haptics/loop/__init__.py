"""Sampled loop of a device and a hand: filters, delays, stability and passivity."""
