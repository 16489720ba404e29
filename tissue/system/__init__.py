"""Processes of this machine and the files they write: helpers, workers, signals, locks, drawing
off screen.
"""
