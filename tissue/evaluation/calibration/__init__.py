"""Calibration of observers: restorable sessions, populations, and the benefit of calibration."""
