"""Runs against the wall clock, in a window with the mouse as device or without one."""

from tissue.live.clock import WallClock
from tissue.live.run import live, moved_by

__all__ = ["WallClock", "live", "moved_by"]
