"""Processes of this machine and their files: helpers, workers, signals, locks, offscreen images."""
