"""The sampled loop of a device and a hand: its filters, delays, stability and passivity."""
