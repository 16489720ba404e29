"""Perceptual scaling of force: intensity, threshold, estimate and command for an observer."""

from tissue.perception.perceived import Perception

__all__ = ["Perception"]
