"""Calibrating observers: sessions that survive interruptions, populations, and what calibration
is good for.
"""
