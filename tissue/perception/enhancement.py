"""Forces changed so that they are discriminated better: weak ones lifted, contrasts about their mean made stronger.

Both are monotone maps of the force's size, and add no information to a scatter that went through them. They help where
the noise that limits a person comes after them: a threshold kappa (F + offset) is passed by more where the force, or
its difference, is greater. They cost fidelity, which a run reports, and make a contact steeper by their slope, by which
the loop is judged.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_range

__all__ = ["LIFT_BELOW_N", "Contrast", "EnhancedForce", "Lift", "steepest"]

LIFT_BELOW_N = 1.0
"""Force at the device up to which it is lifted [N], where none is given."""
RATIO = 2.0
"""Force over its mean up to which a contrast is a power, and beyond which it goes on along a straight line."""
START_N, LEAST_N = 0.5, 0.05
"""Mean of the force before the first contact, and the least one [N]."""
TOUCH_N = 0.02
"""Force below which nothing is touched and the mean stays [N]."""


@dataclass(frozen=True, kw_only=True)
class Lift:
    """Weak forces moved up into the band where a person discriminates best: F (1 + (g - 1) / (1 + F / F0)).

    The slope falls from g at no force to 1; a strong force comes out (g - 1) F0 greater.

    Attributes
    ----------
    gain
        g, at least 1.
    below_N
        F0 [N].
    """

    gain: float = 1.0
    below_N: float = LIFT_BELOW_N

    def __post_init__(self) -> None:
        require_range("gain", self.gain, 1.0, 10.0, "use 1.5, or 1 for none")
        require_range("below_N", self.below_N, 0.01, 100.0, "use 1")

    def size_N(self, force_N: float) -> float:
        """Size of the lifted force [N] for one of at least 0 [N]."""
        return force_N * (1.0 + (self.gain - 1.0) * self.below_N / (self.below_N + force_N))


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """Differences about a mean m made stronger: m (F / m)^p up to twice the mean, a straight line from there.

    Attributes
    ----------
    exponent
        p, at least 1.
    adaptation_s
        Time constant with which the mean follows the force while something is touched [s].
    """

    exponent: float = 1.0
    adaptation_s: float = 2.0

    def __post_init__(self) -> None:
        require_range("exponent", self.exponent, 1.0, 3.0, "use 1.25, or 1 for none")
        require_range("adaptation_s", self.adaptation_s, 0.1, 1e3, "use 2")

    def size_N(self, force_N: float, mean_N: float) -> float:
        """Size of the force with its contrast [N], for a size of at least 0 and a mean above 0 [N]."""
        ratio = force_N / mean_N
        if ratio <= RATIO:
            return mean_N * float(ratio**self.exponent)
        return mean_N * float(RATIO**self.exponent + self.steepest * (ratio - RATIO))

    @property
    def steepest(self) -> float:
        """Greatest slope at a given mean."""
        return float(self.exponent * RATIO ** (self.exponent - 1.0))


def steepest(lift: Lift, contrast: Contrast) -> float:
    """Greatest slope of both after each other, whatever the mean: a contact is that much stiffer to the loop.

    The mean itself follows the force in seconds, far below where a loop can ring.
    """
    return lift.gain * contrast.steepest


class EnhancedForce:
    """Lift and contrast, tick by tick.

    Parameters
    ----------
    lift, contrast
        What is done to the force's size; its direction stays.
    tick_s
        Time between two steps [s].

    Attributes
    ----------
    mean_N
        The mean about which contrast is made stronger [N].
    """

    def __init__(self, lift: Lift, contrast: Contrast, *, tick_s: float) -> None:
        self._lift, self._contrast = lift, contrast
        self._share = tick_s / contrast.adaptation_s
        self.mean_N = START_N

    def step(self, force_N: Array) -> Array:
        """The enhanced force [N] for a finite force at the device [N], both of shape (3,)."""
        x, y, z = force_N.tolist()
        size = sqrt(x * x + y * y + z * z)
        if size == 0.0:
            return np.zeros(3)
        lifted = self._lift.size_N(size)
        wanted = self._contrast.size_N(lifted, self.mean_N)
        if size > TOUCH_N:
            self.mean_N = max(self.mean_N + self._share * (lifted - self.mean_N), LEAST_N)
        return (wanted / size) * force_N
