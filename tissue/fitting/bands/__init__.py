"""Uncertainty bands of a run's loads from the ranges of its constants, and Sobol indices."""
