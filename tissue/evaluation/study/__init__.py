"""Evaluation study with simulated users: trials, their metrics, and a report."""
