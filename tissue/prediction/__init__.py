"""Prediction of force and state some milliseconds ahead.

It contains lifted linear operators and the simple predictors that serve as baselines.
"""
