"""Scaling of forces for an observer, who is a person or a model of a person."""

from tissue.perception.perceived import Perception

__all__ = ["Perception"]
