"""Delay operator that adapts to the running contact by recursive least squares."""

import numpy as np
from scipy.signal import savgol_coeffs

from meshes.base.arrays import Array
from tissue.prediction.delays import COORDINATES, HORIZON, DelayOperator, DelayPath, Moments

__all__ = ["AdaptivePath"]

MEMORY = 1000.0
"""Ticks after which a tick counts 1/e in the fit."""
PRIOR = 0.3
"""Weight of the starting operator in the fit, relative to a run of the same power as in training.

With it, the fit is solvable at rest and returns to the starting operator.
"""
SMOOTHED = 8
"""Ticks to either side over which the target position is smoothed by a parabola.

It removes most of the encoder steps from the target.
"""
INTERVAL = 32
"""Ticks between two solutions of the fit: it costs 30 us, which one tick in 32 pays."""


class AdaptivePath(DelayPath):
    """Delay path whose operator is fitted again in the loop.

    The moments of the last ticks are summed with exponential forgetting (recursive least squares in
    information form). The moments of the starting operator flow in at a constant rate, so that the
    sum is bounded and positive definite whatever the motion is. All axes share the fit, which is
    therefore invariant to rotation. The cost of a tick and the memory are constant.

    Parameters
    ----------
    operator
        Operator to start from.
    """

    def __init__(self, operator: DelayOperator) -> None:
        super().__init__(operator)
        start = operator.moments
        # Moments of three axes over the memory, and their targets, side by side.
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
        """Update the window, and the fit by the oldest kept tick, whose targets are now known.

        Targets are displacements to later positions that the coupling uses.
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
        # A motion outside the training range would outweigh all others for seconds.
        self._good = self._good + 1 if self.trusted else 0
        if self._good > len(past):
            seen = past[-1]
            # From the first tick to the last: the newest smoothed tick is the last.
            targets = (later[::-1] - places[-1]).transpose(1, 0, 2).reshape(2 * HORIZON, 3)
            self._sums += seen.dot(np.concatenate((seen, targets)).T)
        if self._age % INTERVAL == 0:
            moments = Moments(self._sums[:, :COORDINATES], self._sums[:, COORDINATES:])
            self._weights = moments.weights()
            self._maps.clear()
