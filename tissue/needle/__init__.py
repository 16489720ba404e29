"""A needle through a capsule and the tissue behind it."""

from tissue.needle.insertion import Insertion
from tissue.needle.model import NeedleModel
from tissue.needle.parameters import Membrane, NeedleTissue, ShaftFriction, cutting_force_N, needle_tissue

__all__ = [
    "Insertion", "Membrane", "NeedleModel", "NeedleTissue", "ShaftFriction", "cutting_force_N", "needle_tissue",
]  # fmt: skip
