"""Where a device will be: its displacement some ticks ahead, from the positions that its
encoders gave.
"""

from math import floor
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.prediction.baselines import kalman_gains
from tissue.prediction.edmd.lifted import Operator

__all__ = ["STATE", "FilteredPath", "OperatorPath", "Path"]

STATE = 2
"""Entries of an axis' state: what the device has moved in the last tick, and the stretch of its
coupling, both [m].
"""
JERKINESS = 3e-5
"""Variance of the position's third difference over that of its noise: of 1e-6 to 1e-3 the best on
the wall and on palpation together, 1e-4 for the one and 1e-5 for the other."""

MOST_LEADS = 16
"""Times ahead whose maps are kept: a loop asks for one, and for the next tick."""


class Path(Protocol):
    """Predicts the displacement of a device."""

    @property
    def trusted(self) -> bool:
        """Whether what it would predict now follows from what it was made for."""
        ...

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Take in a tick: the device's position and its coupling's force over the coupling's
        stiffness, shape (3,).
        """
        ...

    def displacement_m(self, ticks: float) -> Array:
        """From the position that was observed last to the one to be expected after so many
        ticks, shape (3,).
        """
        ...

    def stretch_m(self, ticks: float) -> Array:
        """The coupling's stretch to be expected after so many ticks, shape (3,)."""
        ...

    def pause(self) -> None:
        """The next position does not follow the last."""
        ...


class FilteredPath:
    """Constant acceleration by a Kalman filter in steady state; the stretch stays."""

    trusted = True

    def __init__(self, jerkiness: float = JERKINESS) -> None:
        self._gains = kalman_gains(
            1, require_positive("jerkiness", jerkiness, f"use {JERKINESS:g}")
        )[:, None]
        self._onward = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        self._state: Array | None = None
        self._position, self._stretch = np.zeros((2, 3))

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Go a tick on and correct by the position."""
        self._stretch = stretch_m.copy()
        if self._state is None:
            self._state = np.zeros((3, 3))
            self._state[0] = position_m
        state = self._state = self._onward.dot(self._state)
        state += self._gains * (position_m - state[0])
        self._position = position_m.copy()

    def displacement_m(self, ticks: float) -> Array:
        """Along the parabola."""
        if self._state is None:
            return np.zeros(3)
        return np.array((1.0, ticks, 0.5 * ticks * ticks)).dot(self._state) - self._position

    def stretch_m(self, ticks: float) -> Array:
        """The last one."""
        return self._stretch

    def pause(self) -> None:
        """Begin anew."""
        self._state = None


class OperatorPath:
    """Displacement and stretch by powers of one operator on the delayed states of an axis, alike
    for all axes.

    States are displacements and stretches, not places, and the operator has no offset; so what is
    predicted moves with the motion, turns with it, and stays the same whatever the newtons are.
    States are shape (STATE,) an axis.

    Parameters
    ----------
    operator
        On `STATE` states with delays, without inputs and offset.
    growth
        Mean square of the scaled states of a window, all axes together, above which it is out of
        training.
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
        """Whether the window is full, and its states in the range of training."""
        if self._ticks <= self._operator.dictionary.lags:
            return False
        scaled = (self._window * self._inverse).ravel()
        return float(scaled.dot(scaled)) <= self._growth

    def observe(self, position_m: Array, stretch_m: Array) -> None:
        """Put a state before the window; the first one fills it, as if the device had been
        still.
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
        """The sum of what the operator moves in the ticks ahead."""
        displacement: Array = self._later(ticks)[0]
        return displacement

    def stretch_m(self, ticks: float) -> Array:
        """The coupling's stretch after so many ticks, shape (3,)."""
        stretch: Array = self._later(ticks)[1]
        return stretch

    def pause(self) -> None:
        """The window is filled anew from the next state on, and not trusted until it is full."""
        self._ticks = 0

    def _later(self, ticks: float) -> Array:
        """Displacement and stretch, shape (STATE, 3)."""
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
        """From a window to what is so many whole ticks ahead, shape (STATE, states)."""
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
