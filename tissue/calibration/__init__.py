"""Calibrating observers: sessions that survive interruptions, populations, and what calibration is good for."""

from tissue.calibration.session import Plan, Session

__all__ = ["Plan", "Session"]
