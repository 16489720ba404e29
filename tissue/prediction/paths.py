"""Predicted displacement of a device, from encoder positions."""

from math import floor
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.prediction.baselines import kalman_gains
from tissue.prediction.edmd.lifted import Operator

__all__ = ["STATE", "FilteredPath", "OperatorPath", "Path"]

STATE = 2
"""Entries of an axis' state [m]: device displacement in the last tick, and coupling stretch."""
JERKINESS = 3e-5
"""Variance of the position's third difference over the variance of its noise.

Of 1e-6 to 1e-3 it is the best value on the wall and on palpation together: 1e-4 for the wall and
1e-5 for palpation alone.
"""

MOST_LEADS = 16
"""Number of leads whose maps are kept: a loop asks for one lead, and for the next tick."""


class Path(Protocol):
    """Predictor of the displacement of a device."""

    @property
    def trusted(self) -> bool:
        """True if a prediction now is within the range that the path was made for."""
        ...

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Update with a tick: the device's position and the coupling's stretch, shape (3,).

        The stretch is the coupling's force over its stiffness.
        """
        ...

    def displacement_m(self, ticks: float) -> Array:
        """Predict the displacement from the last observed position, shape (3,).

        `ticks` is the number of ticks ahead.
        """
        ...

    def stretch_m(self, ticks: float) -> Array:
        """Predict the coupling's stretch after a number of ticks, shape (3,)."""
        ...

    def pause(self) -> None:
        """Pause after a missing sample: the next position does not follow the last."""
        ...


class FilteredPath:
    """Constant acceleration by a steady-state Kalman filter; the stretch is assumed constant."""

    trusted = True

    def __init__(self, jerkiness: float = JERKINESS) -> None:
        self._gains = kalman_gains(
            1, require_positive("jerkiness", jerkiness, f"use {JERKINESS:g}")
        )[:, None]
        self._onward = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        self._state: Array | None = None
        self._position, self._stretch = np.zeros((2, 3))

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Advance by a tick and correct by the position."""
        self._stretch = stretch_m.copy()
        if self._state is None:
            self._state = np.zeros((3, 3))
            self._state[0] = position_m
        state = self._state = self._onward.dot(self._state)
        state += self._gains * (position_m - state[0])
        self._position = position_m.copy()

    def displacement_m(self, ticks: float) -> Array:
        """Return the displacement on the parabola."""
        if self._state is None:
            return np.zeros(3)
        return np.array((1.0, ticks, 0.5 * ticks * ticks)).dot(self._state) - self._position

    def stretch_m(self, ticks: float) -> Array:
        """Return the last stretch."""
        return self._stretch

    def pause(self) -> None:
        """Reset the filter."""
        self._state = None


class OperatorPath:
    """Displacement and stretch by powers of one operator on the delayed states of an axis.

    All axes use one operator. States are displacements and stretches, not positions, and the
    operator has no offset. The prediction is therefore invariant to translation and rotation of the
    motion, and does not depend on the scale of the forces. States have shape (STATE,) an axis.

    Parameters
    ----------
    operator
        Operator on `STATE` states with delays, without inputs and offset.
    growth
        Mean square of the scaled states of a window, all axes together, above which it is outside
        the training range.
    """

    def __init__(self, operator: Operator, *, growth: float) -> None:
        if operator.state_size != STATE or operator.B.shape[1] or operator.offset.any():
            raise InputError(
                "operator",
                f"have {STATE} states, no inputs and no offset",
                f"{operator.state_size} and {operator.B.shape[1]}",
                "train it again",
            )
        self._operator = operator
        self._growth = growth
        self._window = np.zeros((len(operator.offset), 3))
        self._inverse = 1.0 / (operator.scale[:, None] * np.sqrt(len(operator.offset)))
        self._powers: list[Array] = []
        self._maps: dict[float, Array] = {}
        self._position = np.zeros(3)
        self._ticks = 0

    @property
    def trusted(self) -> bool:
        """True if the window is full and its states are in the range of training."""
        if self._ticks <= self._operator.dictionary.lags:
            return False
        scaled = (self._window * self._inverse).ravel()
        return float(scaled.dot(scaled)) <= self._growth

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Add the newest state to the window.

        The first state fills the window, as if the device had been still.
        """
        window = self._window
        if self._ticks == 0:
            window[0::STATE] = 0.0
            window[1::STATE] = stretch_m
        else:
            window[STATE:] = window[:-STATE]
            window[0] = position_m - self._position
            window[1] = stretch_m
        self._position = position_m.copy()
        self._ticks += 1

    def displacement_m(self, ticks: float) -> Array:
        """Return the sum of the operator's displacements over the ticks ahead."""
        displacement: Array = self._later(ticks)[0]
        return displacement

    def stretch_m(self, ticks: float) -> Array:
        """Return the coupling's stretch after a number of ticks, shape (3,)."""
        stretch: Array = self._later(ticks)[1]
        return stretch

    def pause(self) -> None:
        """Clear the window.

        It is filled anew from the next state on, and not trusted until it is full.
        """
        self._ticks = 0

    def _later(self, ticks: float) -> Array:
        """Return displacement and stretch, shape (STATE, 3)."""
        found = self._maps.get(ticks)
        if found is None:
            low = floor(ticks)
            share = ticks - low
            found = (1.0 - share) * self._power(low) + share * self._power(low + 1)
            if len(self._maps) < MOST_LEADS:
                self._maps[ticks] = found
        later: Array = found.dot(self._window)
        return later

    def _power(self, ticks: int) -> Array:
        """Return the matrix from a window to the state some whole ticks ahead.

        Its shape is (STATE, states).
        """
        if not self._powers:
            self._powers.append(
                np.eye(STATE, len(self._operator.offset)) * np.array([[0.0], [1.0]])
            )
        while len(self._powers) <= ticks:
            # S_h = sum of C_x A^j over j = 1..h obeys S_h = (S_{h-1} + C_x) A; the stretch is C_s
            # A^h.
            before = self._powers[-1].copy()
            before[0, 0] += 1.0
            self._powers.append(before @ self._operator.A)
        return self._powers[ticks]
