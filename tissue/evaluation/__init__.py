"""Evaluation of the engine: charts, atlas, study, calibration, statistics, training.

The engine does not import this package.
"""
