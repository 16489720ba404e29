"""Cutters: surfaces of revolution with flutes.

>>> from tissue import cutters
>>> burr = cutters.ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
"""

from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import Arc, Line, Profile
from tissue.cutters.tools import (
    ball_burr,
    cylinder,
    flat_reamer,
    hemispherical_reamer,
    of_profile,
    pear_bur,
    twist_drill,
)

__all__ = [
    "Arc",
    "Cutter",
    "Line",
    "Profile",
    "ball_burr",
    "cylinder",
    "flat_reamer",
    "hemispherical_reamer",
    "of_profile",
    "pear_bur",
    "twist_drill",
]
