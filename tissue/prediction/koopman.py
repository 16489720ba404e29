"""Lifted linear predictor in the loop: powers of an operator on displacements and stretches.

The displacements are the device's, the stretches are the coupling's.
"""

from math import floor, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.operator import Operator
from tissue.prediction.predictor import Contact

__all__ = ["STATE", "Koopman", "OperatorPath"]

STATE = 2
"""Entries of an axis' state [m]: device displacement in the last tick, and coupling stretch."""
MOST_LEADS = 16
"""Number of leads whose maps are kept: a loop asks for one lead, and for the next tick."""

LEAST_DEPTH_M = 2e-4
"""Smallest depth at which a contact's stiffness is estimated [m]: four encoder steps.

A surface that moves by more than this depth counts as a new surface.
"""

RELEASED = 20
"""Ticks without force after which a contact ends.

A shorter gap is chatter of a cut, which leaves no surface.
"""
REMEMBERED = 0.95
"""Factor per tick on past forces in the estimate of their direction: a decaying force has none."""


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
            # Between two whole ticks the maps are interpolated.
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


class Koopman:
    """Force prediction from recent displacements and stretches of a device, without the tissue.

    The force is the coupling's stiffness times the stretch that the operator predicts. A predicted
    force that opposes the present force is replaced by zero.

    A device that has been free for some ticks has zero force until its path reaches the surface of
    the last contact. The surface is the plane through the end of that contact, normal to its force.
    The plane is used only if the contact also began there. Beyond the plane, the tissue has the
    stiffness of that contact.

    Parameters
    ----------
    path
        Predictor of displacement and stretch.
    """

    residual_N = 0.0
    is_primary = True

    def __init__(self, path: OperatorPath) -> None:
        self.path = path
        self._spring = 0.0
        self._position, self._force, self._normal, self._push, self._surface, self._begun = (
            np.zeros((6, 3))
        )
        self._answered, self._answer = np.zeros((2, 3))
        self._share = 1.0
        self._known = False
        self._free = 0

    @property
    def trusted(self) -> bool:
        """True if the path is trusted and the coupling's stiffness is known."""
        return self._spring > 0.0 and self.path.trusted

    def meet(self, contact: Contact) -> None:
        """Store the coupling's stiffness; the tissue's law is not used."""
        self._spring = contact.spring_N_m

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the device and the force.

        In a tick without a force, the last contact gives the force at the new device position. The
        operator's own prediction is not fed back: a predicted stretch together with measured
        displacements is no trajectory of the operator. Where a tissue answers every tenth tick,
        such a stretch grew beyond all bounds within seconds.
        """
        if self._spring == 0.0:
            if force_N is not None:
                self._force = force_N.copy()
            return
        if force_N is None:
            self._free += 1
            self._force = self._moved_N(position_m)
            self._position = position_m.copy()
            self.path.observe(position_m, self._force / self._spring)
            return
        missed = force_N - self._spring * self.path.stretch_m(1.0)
        self.residual_N = sqrt(float(missed @ missed))
        touched = any(self._answer.tolist())
        self._force = force_N.copy()
        self._answer = force_N.copy()
        touches = any(self._force.tolist())
        if touches:
            self._push = REMEMBERED * self._push + self._force
            self._normal = self._push / sqrt(float(self._push @ self._push))
        if touches and not touched:
            self._begun = position_m.copy()
            self._surface = position_m.copy()
        elif touched and not touches:
            # Contact ended at the start of a tick's motion. Where it ended deeper than it began,
            # the tissue has been cut.
            self._surface = self._position.copy()
            self._known = abs(float(self._normal @ (self._surface - self._begun))) < LEAST_DEPTH_M
        if touches:
            depth = float(self._normal @ (self._surface - position_m))
            if depth > LEAST_DEPTH_M:
                self._share = min(float(self._normal @ self._force) / (self._spring * depth), 1.0)
        self._free = 0 if touches else self._free + 1
        self._position = position_m.copy()
        self._answered = position_m.copy()
        self.path.observe(position_m, self._force / self._spring)

    def predict(self, ticks: float) -> Array:
        """Return the predicted stretch times the coupling's stiffness."""
        if ticks == 0.0 or self._spring == 0.0:
            return self._force.copy()
        if any(self._force.tolist()):
            stretch = self.path.stretch_m(ticks)
            # Tissue does not pull: a stretch in the other direction means that the contact has
            # ended.
            return self._spring * stretch if float(stretch @ self._force) > 0.0 else np.zeros(3)
        return self._touched_N(self._position + self.path.displacement_m(ticks))

    def pause(self) -> None:
        """Clear the window, so that it is filled anew."""
        self.path.pause()

    def _moved_N(self, position_m: Array) -> Array:
        """Return the force on a device that has moved since the tissue's last answer."""
        if not any(self._answer.tolist()):
            return self._touched_N(position_m)
        into = float(self._normal @ (self._answered - position_m))
        force = self._answer + self._spring * self._share * into * self._normal
        return force if float(force @ self._answer) > 0.0 else np.zeros(3)

    def _touched_N(self, at_m: Array) -> Array:
        """Return the force on a free device beyond the surface of the last contact.

        It is zero if no surface is known.
        """
        if not self._known or self._free < RELEASED:
            return np.zeros(3)
        overlap = max(float(self._normal @ (self._surface - at_m)), 0.0)
        return self._spring * self._share * overlap * self._normal
