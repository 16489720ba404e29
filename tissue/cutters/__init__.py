"""Cutters: surfaces of revolution with flutes."""

from tissue.cutters.cutter import Cutter, DistanceTable, PointShell
from tissue.cutters.profile import (
    Arc,
    Line,
    Piece,
    Profile,
    ball_burr,
    cylinder,
    flat_reamer,
    hemispherical_reamer,
    pear_bur,
    twist_drill,
)

__all__ = [
    "Arc",
    "Cutter",
    "DistanceTable",
    "Line",
    "Piece",
    "PointShell",
    "Profile",
    "ball_burr",
    "cylinder",
    "flat_reamer",
    "hemispherical_reamer",
    "pear_bur",
    "twist_drill",
]
