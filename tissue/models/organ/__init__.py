"""A soft organ under a probe, with contact computed from the compliance of its surface."""
