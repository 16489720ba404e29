"""A predictor, which needs only the methods `observe` and `predict`."""

import numpy as np
from numpy.typing import NDArray

from tissue import register

Floats = NDArray[np.float64]
FADE = 0.9
"""Ratio of the slope of the force in a tick to the slope in the tick before."""


@register.predictor("damped-line")
class DampedLine:
    """Predictor that continues the force along a fading slope.

    The force n ticks after the last force F is F + s (1 - r^n) / (1 - r). The slope per tick is s,
    and r is `FADE`.
    """

    def __init__(self) -> None:
        self.force_N = np.zeros(3)
        self.slope_N = np.zeros(3)
        self.age = 0

    def observe(self, position_m: Floats, velocity_m_s: Floats, force_N: Floats | None) -> None:
        """Observe the force of a tick. It is None if the tissue model has no force in this tick."""
        self.age += 1  # ticks since the last force
        if force_N is not None:
            fade = FADE**self.age
            slope_N = (force_N - self.force_N) / self.age
            self.slope_N = fade * self.slope_N + (1.0 - fade) * slope_N
            self.force_N = force_N
            self.age = 0

    def predict(self, ticks: float) -> Floats:
        """Return the expected force a number of ticks later [N]."""
        later = self.age + ticks
        return self.force_N + (1.0 - FADE**later) / (1.0 - FADE) * self.slope_N
