"""Processes and files: child processes, signals, locks, offscreen images."""
