"""The vibration of a cutter's teeth, within the band that a haptic loop can carry."""

from fractions import Fraction
from math import cos, inf, lcm, pi, sin, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.filters import LowPass

__all__ = ["BAND_LIMIT_HZ", "PlayedVibration", "Vibration"]

BAND_LIMIT_HZ = 250.0
"""Highest frequency rendered [Hz]: a quarter of the tick rate, where vibration is felt best
(Pacinian receptors).
"""
ENVELOPE_S = 0.05
"""Time over which the force is averaged that a device's vibration goes with [s]: a loop that may
ring at 10 Hz and more gets a third of it back at most, moved to 250 Hz, where a hand and a device
hardly move."""
MOST_PERIOD_TICKS = 200
"""Longest period by which a loop is judged [ticks]: from 5 Hz at 1 kHz on, off by half a per
cent of f at most.
"""
SLEW_SHARE = 0.5
"""Share of the device's slew that the vibration may use."""


class Vibration:
    """A zero-mean modulation of the cutting force.

    A cutter with N edges that turns omega / 2 pi times a second meets the tissue with a ripple at f
    = N omega / 2 pi. Sampled at the tick rate R, a ripple above R / 2 comes back as a false slow
    force at the distance of f from the nearest multiple of R. Here the model's force is the average
    over a revolution, which holds no ripple, and the vibration is added at a frequency below the
    band's limit: its own where that is lower, else the limit.

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
        self.share = share
        self._turns = self.frequency_Hz * step_s

    def factor(self, tick: int) -> float:
        """What the average force is multiplied by and added to itself at a tick."""
        return self.share * cos(2.0 * pi * self._turns * tick)

    def period(self, model_ticks: int = 1) -> Array:
        """Factors of all ticks until it and a model of so many ticks begin together again, shape
        (model_ticks, n).

        Of the nearest vibration with a period of at most `MOST_PERIOD_TICKS` ticks where its own is
        longer.
        """
        turns = Fraction(self._turns).limit_denominator(MOST_PERIOD_TICKS) or Fraction(
            1, MOST_PERIOD_TICKS
        )
        ticks = np.arange(lcm(turns.denominator, model_ticks)) % turns.denominator
        return self.share * np.cos(2.0 * pi * float(turns) * ticks).reshape(-1, model_ticks).T


class PlayedVibration:
    """What a device plays of it, added to the force that it plays.

    Amplitude and direction are those of the force over the last tenth of a second: F_v = share E
    cos(2 pi f t) with E' = (F - E) / tau. So within a period it does not depend on the state of the
    loop. A change of the force comes back through it by at most share / sqrt(1 + (2 pi f tau)^2),
    at frequencies f to either side of the vibration's own: the loop's judge knows it
    (`tissue.haptics.loop.sampled_loop`), without limit and slew, which only make it smaller. The
    amplitude leaves the sum within the device's greatest force, and half of the device's slew to
    the force itself: a loop whose slew is used up rings.

    Parameters
    ----------
    vibration
        Its frequency and share.
    limit_N, slew_N
        Greatest force of the device and its greatest change in a tick [N].
    step_s
        Length of a tick [s].
    """

    def __init__(
        self, vibration: Vibration, *, limit_N: float, slew_N: float = inf, step_s: float
    ) -> None:
        self._vibration = vibration
        self._limit = limit_N
        self._most = SLEW_SHARE * slew_N / (2.0 * sin(pi * vibration.frequency_Hz * step_s))
        self._envelope = LowPass(ENVELOPE_S, step_s=step_s)
        self._tick = 0

    def step(self, force_N: Array) -> Array:
        """The vibration in a tick in which this force is played [N], shape (3,)."""
        self._tick += 1
        level = self._envelope.step(force_N)
        amplitude = self._vibration.share * sqrt(level.dot(level))
        most = min(self._most, max(self._limit - sqrt(force_N.dot(force_N)), 0.0))
        factor = self._vibration.factor(self._tick)
        return level * (factor if amplitude <= most else factor * most / amplitude)

    def pause(self) -> None:
        """Nothing is played in a tick without a sample, so that it begins from nothing again."""
        self._tick += 1
        self._envelope.value = np.zeros(3)
