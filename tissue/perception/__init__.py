"""Scaling of forces for an observer, a person or a model of a person who perceives them."""

from tissue.perception.perceived import Perception

__all__ = ["Perception"]
