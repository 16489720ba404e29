"""A run that a real device moves follows the wall clock, whatever else goes along with it."""

import numpy as np
from numpy.typing import NDArray

from tissue.builders.parts import Parts
from tissue.models.tissue_model import TICK_S
from tissue.simulation.live.clock import WallClock
from tissue.simulation.simulate import RunObserver

__all__ = ["Paced"]

BEHIND = "the ticks were {:.3g} s behind the wall clock in all, which skipped it: the device was played later than that"


class Paced:
    """Goes along with the ticks: each waits until it is due, and what another observer does goes on as before.

    Parameters
    ----------
    inner
        The other one, None for none.
    """

    def __init__(self, inner: RunObserver | None = None) -> None:
        self._inner, self._clock, self._skipped_s = inner, WallClock(TICK_S), 0.0
        self.timing_columns: tuple[str, ...] = () if inner is None else inner.timing_columns

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """The ticks begin."""
        if self._inner is not None:
            self._inner.on_begin(parts, columns)

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due."""
        if self._inner is not None:
            self._inner.before_tick(index)
        self._clock.wait(index)
        self._skipped_s += self._clock.skipped_s

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Hand a tick on; whether the run goes on."""
        return self._inner is None or self._inner.on_tick(index, row, times)

    def on_end(self) -> list[tuple[float, str]]:
        """What has happened, and by how much the wall clock was missed."""
        found = [] if self._inner is None else self._inner.on_end()
        return found + ([(0.0, BEHIND.format(self._skipped_s))] if self._skipped_s > 0.0 else [])
