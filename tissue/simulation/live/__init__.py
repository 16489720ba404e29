"""Live runs in real time."""
