"""The recursive estimate of a level that wanders: the scalar Kalman filter, and a person's sense of force as one."""

from dataclasses import dataclass
from math import exp, sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import require_positive, require_range
from tissue.perception.psychometric import D_PRIME_75
from tissue.perception.weber import Weber

__all__ = ["LocalLevel", "Sense"]

Level = TypeVar("Level", float, NDArray[np.float64])
BLOCK = 512
"""Ticks whose random numbers are drawn at once."""


@dataclass(frozen=True, kw_only=True)
class LocalLevel:
    """A level that wanders by a variance q a step and is observed with a variance r (Kalman 1960; E8)::

        P = sigma^2 + q,   G = P / (P + r),   level += G (seen - level),   sigma^2 = G r

    The printed sigma^2 = q r / (q + r) leaves the last variance out of P: 0.5 at q = r = 1, where the filter's steady
    state is (-q + sqrt(q^2 + 4 q r)) / 2 = 0.618.

    Attributes
    ----------
    wander, noise
        Variances q and r.
    """

    wander: float
    noise: float

    def __post_init__(self) -> None:
        require_range("wander", self.wander, 0.0, 1e12, "use 0 for a level that stays")
        require_positive("noise", self.noise, "use the variance of one observation")

    def step(self, level: Level, variance: float, seen: Level) -> tuple[Level, float]:
        """Level, or many levels, and variance after one more observation."""
        predicted = variance + self.wander
        gain = predicted / (predicted + self.noise)
        return level + gain * (seen - level), gain * self.noise

    @property
    def steady_variance(self) -> float:
        """Variance after many observations."""
        return 0.5 * (sqrt(self.wander**2 + 4.0 * self.wander * self.noise) - self.wander)


class Sense:
    """What a person takes a force for: a noisy look at it every tick, averaged by the steady filter.

    The gain is that of the time over which force is averaged, 1 - exp(-T / tau), and the noise of a look is such that
    the estimate of a constant force scatters by the threshold: a change of one threshold is d' = 0.954 from none.
    For this gain G and scatter s a look has the variance r = s^2 (2 - G) / G, and the filter assumes that the force
    wanders by q = G^2 r / (1 - G) a tick.

    Attributes
    ----------
    force_N
        The estimate [N]; a size, never below 0.
    """

    def __init__(self, law: Weber, *, integration_s: float, tick_s: float, rng: np.random.Generator) -> None:
        self.gain = 1.0 - exp(-tick_s / integration_s)
        self._kappa, self._offset = law.kappa, law.offset
        self._noise_ratio = sqrt((2.0 - self.gain) / self.gain) / D_PRIME_75
        self._rng, self._drawn = rng, list[float]()
        self._level = self.force_N = 0.0

    def at(self, force_N: float) -> LocalLevel:
        """The filter that this sense is at a force [N]."""
        noise = (self._noise_ratio * self._kappa * (force_N + self._offset)) ** 2
        return LocalLevel(wander=self.gain**2 * noise / (1.0 - self.gain), noise=noise)

    def step(self, force_N: float) -> float:
        """Look at a force [N] once; the new estimate."""
        if not self._drawn:
            self._drawn = self._rng.standard_normal(BLOCK).tolist()
        seen = force_N + self._noise_ratio * self._kappa * (force_N + self._offset) * self._drawn.pop()
        self._level += self.gain * (seen - self._level)
        self.force_N = self._level if self._level > 0.0 else 0.0
        return self.force_N
