"""Fit of material constants to a measured force log.

The fit reports the constants that the log determines, the constants that it does not determine, and
the log to measure next.
"""
