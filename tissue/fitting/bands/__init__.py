"""Uncertainty bands of the loads of a run, and Sobol indices of the constants of the run."""
