"""Force prediction from the recent motion of device and tool, without a law of the tissue."""

from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.prediction.delays import DelayPath
from tissue.prediction.predictor import Contact

LEAST_DEPTH_M = 2e-4
"""Smallest depth at which the stiffness of a contact is estimated [m].

The value is about four encoder steps of a Touch. If the surface positions at the start and at the
end of a contact differ by at least this value, the surface is treated as unknown.
"""

RELEASED = 20
"""Number of ticks without force after which a contact ends.

A shorter time without force may be caused by chatter of a cutting tool, and does not end the
contact.
"""
REMEMBERED = 0.95
"""Factor per tick by which the weight of a past force decays in the estimated force direction.

The direction is estimated from past forces, because a force close to zero has no reliable
direction.
"""


class Koopman:
    """Force predictor that uses recent motions of a device and stretches of its coupling spring.

    The predicted force is the stiffness of the coupling times the predicted stretch of the
    coupling. If the predicted force is opposite to the present force, it is replaced by zero.

    If the tool has touched nothing for some ticks, the predicted force is zero until the predicted
    path reaches the surface of the last contact. The surface is modelled as the plane through the
    point where the contact ended, normal to the contact force. The plane is used only if the
    contact also began on it. Beyond the plane, the predicted force is computed with the stiffness
    of the last contact.

    Parameters
    ----------
    path
        Predictor of the displacement of the device and the stretch of the coupling.
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
        """True if the prediction of the motion is trusted and the coupling's stiffness is known."""
        return self._spring > 0.0 and self.path.trusted

    def meet(self, contact: Contact) -> None:
        """Store the coupling's stiffness. The law of the tissue is not used."""
        self._spring = contact.spring_N_m

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the position of the device and the force on the device.

        In a tick without a force, the force at the new device position is computed from the last
        contact. A predicted force is not used as an observation, because it would mix a predicted
        stretch with measured displacements. In a test in which the tissue responded only in every
        tenth tick, using predicted forces as observations made the predicted stretch diverge within
        seconds.
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
            # The contact ended at the start of a tick's motion. If it ended deeper than it began,
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
        """Return the predicted force, see `Koopman`."""
        if ticks == 0.0 or self._spring == 0.0:
            return self._force.copy()
        if any(self._force.tolist()):
            stretch = self.path.stretch_m(ticks)
            # Tissue does not pull. A stretch in the other direction means that the contact has
            # ended.
            return self._spring * stretch if float(stretch @ self._force) > 0.0 else np.zeros(3)
        return self._touched_N(self._position + self.path.displacement_m(ticks))

    def pause(self) -> None:
        """Discard the previous samples."""
        self.path.pause()

    def _moved_N(self, position_m: Array) -> Array:
        """Return the force [N] on a device that has moved since the last response of the tissue."""
        if not any(self._answer.tolist()):
            return self._touched_N(position_m)
        into = float(self._normal @ (self._answered - position_m))
        force = self._answer + self._spring * self._share * into * self._normal
        return force if float(force @ self._answer) > 0.0 else np.zeros(3)

    def _touched_N(self, at_m: Array) -> Array:
        """Return the force [N] on a device at a position behind the surface of the last contact.

        The force is zero if no surface is known.
        """
        if not self._known or self._free < RELEASED:
            return np.zeros(3)
        overlap = max(float(self._normal @ (self._surface - at_m)), 0.0)
        return self._spring * self._share * overlap * self._normal
