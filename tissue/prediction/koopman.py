"""Force prediction from the past of device and coupling, without the law of the tissue."""

from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.prediction.delays import DelayPath
from tissue.prediction.predictor import Contact

__all__ = ["Koopman"]

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

    def __init__(self, path: DelayPath) -> None:
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
