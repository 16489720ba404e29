"""Uncertainty bands of a run from the ranges of its constants; influence of each constant."""
