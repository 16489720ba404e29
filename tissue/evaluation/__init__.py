"""What evaluates the engine, which knows nothing of it: charts, atlas, study, calibration,
statistics, training.
"""
