"""Constants identified from a measured force log: what the log determines, what it does not,
what to measure next.
"""
