"""Statistics of a study: metrics of a trial, the table of trials, and tests that state what they
rest on.
"""
