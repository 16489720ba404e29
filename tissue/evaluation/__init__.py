"""Evaluation of the simulation engine: accuracy, stability, user studies and training.

The simulation itself does not import this package.
"""
