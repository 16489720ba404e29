"""Calibration of observers: sessions that can be continued, populations, benefit of calibration."""
