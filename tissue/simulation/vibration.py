"""The vibration of a cutter's teeth, rendered within the band that a haptic loop can carry.

A cutter with N edges that turns omega / 2 pi times a second meets the tissue with a ripple at f = N omega / 2 pi.
Sampled at the tick rate R, a ripple above R / 2 comes back as a false slow force at the distance of f from the nearest
multiple of R. Here the model's force is the average over a revolution, which holds no ripple, and the vibration is
added at a frequency below the band's limit: its own where that is lower, else the limit.
"""

from math import cos, pi

__all__ = ["BAND_LIMIT_HZ", "Vibration"]

BAND_LIMIT_HZ = 250.0
"""Highest frequency rendered [Hz]: a quarter of the tick rate, where vibration is felt best (Pacinian receptors)."""


class Vibration:
    """A zero-mean modulation of the cutting force.

    Parameters
    ----------
    tooth_passing_Hz
        Rate at which edges pass [Hz].
    share
        Amplitude relative to the average force.
    step_s
        Length of a tick [s].
    """

    def __init__(self, tooth_passing_Hz: float, *, share: float, step_s: float) -> None:
        self.frequency_Hz = min(tooth_passing_Hz, BAND_LIMIT_HZ)
        self._share, self._turn = share, 2.0 * pi * self.frequency_Hz * step_s

    def factor(self, tick: int) -> float:
        """What the average force is multiplied by and added to itself at a tick."""
        return self._share * cos(self._turn * tick)
