"""Bands of a run for the ranges of its constants, and the influence of each constant."""
