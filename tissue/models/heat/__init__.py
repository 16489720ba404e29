"""Heat of cutting in bone and teeth."""
