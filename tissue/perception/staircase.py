"""Staircases: a step goes up after one wrong answer and down after some right ones in a row."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range

__all__ = ["Staircase"]


class Staircase:
    """1-up-n-down staircases of many observers side by side (Levitt, 1971).

    Up and down by the same factor, they settle where n right answers in a row are as likely as not, so at a share of
    right answers of (1/2)^(1/n): 70.7 % for two down, 79.4 % for three. The factor starts large and is made small after
    the first reversals; the threshold is the geometric mean of the steps at the later ones.

    Parameters
    ----------
    start
        First step, easily felt; any unit.
    down
        Right answers in a row before the step falls, 1 or more.
    observers
        How many answer side by side.
    coarse, fine
        Factors by which a step changes at first, and after `coarse_reversals` reversals.
    coarse_reversals
        Reversals that are not counted in the threshold.

    Attributes
    ----------
    level
        Next step to ask, shape (observers,).
    reversals
        How often each has turned, shape (observers,).
    """

    def __init__(
        self,
        start: float,
        *,
        down: int,
        observers: int = 1,
        coarse: float = 1.6,
        fine: float = 1.15,
        coarse_reversals: int = 3,
    ) -> None:
        self.level: Array = np.full(observers, require_positive("start", start, "use a step that is easily felt"))
        self._down = int(require_range("down", down, 1, 10, "use 2 for 70.7 % or 3 for 79.4 %"))
        self._coarse = require_range("coarse", coarse, 1.001, 100.0, "use 1.6")
        self._fine = require_range("fine", fine, 1.001, coarse, "use 1.15")
        self._coarse_reversals = coarse_reversals
        self._row = np.zeros(observers, dtype=int)
        self._direction = np.zeros(observers, dtype=int)
        self.reversals = np.zeros(observers, dtype=int)
        self._log_sum, self._counted = np.zeros(observers), np.zeros(observers, dtype=int)

    @property
    def target(self) -> float:
        """Share of right answers at which the staircase settles."""
        return float(0.5 ** (1.0 / self._down))

    def answer(self, correct: NDArray[np.bool_]) -> None:
        """Take one answer of each observer at its `level`."""
        self._row = np.where(correct, self._row + 1, 0)
        falls = self._row == self._down
        moves = np.where(~np.asarray(correct), 1, np.where(falls, -1, 0))
        self._row[falls] = 0
        turns = (moves != 0) & (self._direction != 0) & (moves != self._direction)
        counted = turns & (self.reversals >= self._coarse_reversals)
        self._log_sum += np.where(counted, np.log(self.level), 0.0)
        self._counted += counted
        self.reversals += turns
        factor = np.where(self.reversals < self._coarse_reversals, self._coarse, self._fine)
        self.level = self.level * factor**moves
        self._direction = np.where(moves != 0, moves, self._direction)

    def threshold(self) -> Array:
        """Geometric mean of the steps at the counted reversals; the present level where there is none, (observers,)."""
        logs = np.where(self._counted > 0, self._log_sum / np.maximum(self._counted, 1), np.log(self.level))
        return np.exp(logs)
