"""Evaluation study by one command: many trials of tasks, groups and methods, and a report."""
