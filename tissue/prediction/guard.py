"""When a predictor is believed, and what is played while it is not."""

from math import isfinite, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.errors import require_positive
from tissue.prediction.predictor import Predictor

__all__ = ["Guarded", "Judged"]

Array = NDArray[np.float64]
BLEND = 10
"""Ticks over which one predictor's force goes over into the other's."""
ABSURD = 1e6
"""Metres, metres a second or newtons that no device has."""
PROBATION = 50
"""Ticks for which a predictor must be trusted before it is asked again."""


class Judged(Predictor, Protocol):
    """A predictor that knows whether it can be trusted."""

    @property
    def trusted(self) -> bool:
        """Whether what it would tell now follows from what it has learnt."""
        ...


class Guarded:
    """A predictor for as long as it can be trusted, and another one in its place: no step in between.

    The force told is the other's plus a share of the way to the predictor's own. The share falls from 1 to 0 over some
    ticks when trust ends, and rises as slowly once it has lasted for a while. The way is bounded, and where it is not
    finite the last one stands, so a handover changes the force by no more than the bound over those ticks.

    Parameters
    ----------
    inner
        The predictor to guard.
    instead
        What is asked while it is not trusted.
    reach_N
        Greatest way between both [N].
    """

    residual_N = 0.0
    own = True

    def __init__(self, inner: Judged, instead: Predictor, *, reach_N: float) -> None:
        self.inner, self.instead = inner, instead
        self._reach = require_positive("reach_N", reach_N, "use the device's greatest force")
        self._share, self._good = 1.0, PROBATION
        self._way = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Pass the sample on and judge; one that is not finite, or absurd, counts as none."""
        if not (_sane(position_m) and _sane(velocity_m_s) and (force_N is None or _sane(force_N))):
            self.pause()
            return
        self.inner.observe(position_m, velocity_m_s, force_N)
        self.instead.observe(position_m, velocity_m_s, force_N)
        self.residual_N = self.inner.residual_N
        self._good = self._good + 1 if self.inner.trusted else 0
        change = 1.0 / BLEND
        self._share = min(self._share + change, 1.0) if self._good >= PROBATION else max(self._share - change, 0.0)
        self.own = self._share > 0.5

    def ahead(self, ticks: int) -> Array:
        """Between both, by the share."""
        safe = self.instead.ahead(ticks)
        if self._share == 0.0:
            return safe
        way = self.inner.ahead(ticks) - safe
        size = float(way @ way)
        if not isfinite(size):
            way = self._way
        elif size > self._reach**2:
            way *= self._reach / sqrt(size)
        self._way = way
        return safe + self._share * way

    def pause(self) -> None:
        """Pass it on."""
        self.inner.pause()
        self.instead.pause()


def _sane(vector: Array) -> bool:
    """Whether three numbers are finite and not absurd."""
    x, y, z = vector.tolist()
    return -ABSURD < x < ABSURD and -ABSURD < y < ABSURD and -ABSURD < z < ABSURD
