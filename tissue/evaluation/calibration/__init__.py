"""Calibration of force perception: sessions of trials, population fits, simulated observers."""
