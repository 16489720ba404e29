"""Processes and files: helper and worker processes, signals, locks, offscreen images."""
