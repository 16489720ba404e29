"""Delay operator that is adapted during a run by recursive least squares."""

import numpy as np
from scipy.signal import savgol_coeffs

from meshes.base.arrays import Array
from tissue.prediction.delays import COORDINATES, HORIZON, DelayOperator, DelayPath, Moments

MEMORY = 1000.0
"""Number of ticks after which the weight of a sample in the fit has decayed to 1/e."""
PRIOR = 0.3
"""Weight of the initial operator in the fit, divided by the weight of the data of the run.

The ratio is valid for a motion whose power equals the power of the training data.

The weight of the initial operator makes the fit solvable at rest. The fit then returns to the
initial operator.
"""
SMOOTHED = 8
"""Number of ticks before and after a target position to which a parabola is fitted.

The target position is taken from the parabola, which removes most of the effect of encoder steps.
"""
INTERVAL = 32
"""Number of ticks between two solutions of the fit, each of which takes 60 us."""


class AdaptivePath(DelayPath):
    """Predictor like `DelayPath`, but with an operator that is fitted again during the run.

    The moments of the last ticks are summed with exponential forgetting (recursive least squares in
    information form). The moments of the initial operator are added at a constant rate. For any
    motion, forgetting therefore bounds the sum, and the initial moments keep it positive definite.
    All axes share the fit, so that the fit is invariant to rotation. Time per tick and memory are
    constant.

    Parameters
    ----------
    operator
        Initial operator.
    """

    def __init__(self, operator: DelayOperator) -> None:
        super().__init__(operator)
        start = operator.moments
        # Moments of the coordinates of three axes, and of their targets, in adjacent columns.
        targets = start.coordinates @ self._weights.T
        self._start = 3.0 * PRIOR * np.hstack((start.coordinates, targets))
        self._sums = MEMORY * (1.0 + 1.0 / PRIOR) * self._start
        count = HORIZON + SMOOTHED + 1
        self._past = np.zeros((count, COORDINATES, 3))
        self._places = np.zeros((count, 2, 3))
        self._smooth = savgol_coeffs(2 * SMOOTHED + 1, 2)
        self._used = np.zeros((2 * SMOOTHED + 1, 2, 3))
        self._later = np.zeros((HORIZON, 2, 3))
        self._age = 0
        self._good = 0

    def observe(self, position_m: Array, stretch_m: Array, filtered_m: Array | None = None) -> None:
        """Update with a sample, and add to the fit the newest tick whose targets are known.

        The targets of a tick are the displacements to later positions, and the changes of the
        stretch until then. If the coupling filters the device position, the later positions in the
        targets are filtered positions.
        """
        super().observe(position_m, stretch_m)
        past = self._past
        past[1:] = past[:-1]
        past[0] = self._coordinates
        places = self._places
        places[1:] = places[:-1]
        places[0] = self._recent[0]
        used = self._used
        used[1:] = used[:-1]
        used[0] = self._recent[0]
        if filtered_m is not None:
            used[0, 0] = filtered_m
        later = self._later
        later[1:] = later[:-1]
        # Smoothed position and stretch of the tick that is now in the middle of the window.
        later[0] = self._smooth.dot(used.reshape(-1, 6)).reshape(2, 3)
        self._age += 1
        self._sums *= 1.0 - 1.0 / MEMORY
        self._sums += self._start
        # A motion outside the training range would dominate the fit for seconds.
        self._good = self._good + 1 if self.trusted else 0
        if self._good > len(past):
            seen = past[-1]
            # From the first to the last tick; the newest smoothed tick is the last.
            targets = (later[::-1] - places[-1]).transpose(1, 0, 2).reshape(2 * HORIZON, 3)
            self._sums += seen.dot(np.concatenate((seen, targets)).T)
        if self._age % INTERVAL == 0:
            moments = Moments(self._sums[:, :COORDINATES], self._sums[:, COORDINATES:])
            self._weights = moments.weights()
            self._maps.clear()
