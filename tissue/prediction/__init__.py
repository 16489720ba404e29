"""Prediction of force and state some milliseconds ahead.

The package contains predictors with linear operators on previous samples (delay coordinates), and
simple predictors as baselines.
"""
