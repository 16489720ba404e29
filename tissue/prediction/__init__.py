"""Prediction of force and state some milliseconds ahead.

The package has linear operators on delay coordinates, and simple predictors as baselines.
"""
