"""Detection of states that arrive in a wrong order, without sequence numbers."""

from math import exp, hypot

from tissue.haptics.real.adapter import HardwareSample

__all__ = ["StateOrder"]

MEMORY_S, LONGEST_S = 0.024, 0.005
"""Averaging time of contradictions, and longest time for which one state counts [s].

With this averaging time, a velocity may lag 6 ms behind a blow.
"""
WRONG, RIGHT = 0.25, 0.05
"""Share of contradictions above which the order is wrong, and below which it is right again."""
LEAST_M, LEAST_M_S = 2e-4, 0.05
"""Smallest step [m] and speed [m/s] that are judged.

Below them, a wrong order has no perceptible effect.
"""
AGAINST = -0.5
"""Cosine of the angle between step and velocity below which they contradict each other."""


class StateOrder:
    """Comparison of the steps between states with the velocities of the states.

    A state that is older than the previous one steps back against the velocity of both. In a random
    order, about half of the states do. A share of a quarter is reached within 17 ms.

    Attributes
    ----------
    is_wrong
        True if recent states came in a wrong order.
    """

    def __init__(self) -> None:
        self.is_wrong = False
        self._share = self._came_s = 0.0
        self._last: HardwareSample | None = None

    def observe(self, sample: HardwareSample, time_s: float) -> bool:
        """Process a state that came at a time [s], and return whether the order is wrong."""
        last = self._last
        elapsed = min(time_s - self._came_s, LONGEST_S)
        self._last = sample
        self._came_s = time_s
        if last is None:
            return False
        (x, y, z) = sample.position_m
        (a, b, c) = last.position_m
        step = x - a, y - b, z - c
        speed = [
            0.5 * (one + other)
            for one, other in zip(sample.velocity_m_s, last.velocity_m_s, strict=True)
        ]
        length = hypot(*step)
        fast = hypot(*speed)
        against = length > LEAST_M and fast > LEAST_M_S
        against = (
            against
            and step[0] * speed[0] + step[1] * speed[1] + step[2] * speed[2]
            < AGAINST * length * fast
        )
        self._share += (1.0 - exp(-elapsed / MEMORY_S)) * (against - self._share)
        if self._share > WRONG:
            self.is_wrong = True
        elif self._share < RIGHT:
            self.is_wrong = False
        return self.is_wrong
