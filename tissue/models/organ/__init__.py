"""A soft organ under a probe: contact on the compliance of its surface."""
