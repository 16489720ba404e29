"""What every setting of a scene costs and what it is worth, measured on this machine."""
