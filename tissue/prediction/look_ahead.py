"""Force of the tissue's own law at the predicted place of the device, and the slope of that law,
learnt in contact.
"""

from math import isfinite, sqrt

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.prediction.contact import Contact
from tissue.prediction.paths import Path

__all__ = ["ContactSlope", "LookAhead"]

RIGID = 1e3
"""Stiffness over the coupling's of a tissue that is known to be near and that nothing has
touched yet.
"""
NOISE_M = 1e-6
"""What a force, over the coupling's stiffness, is off a linear law in a tick [m]: curvature and
friction.
"""
DRIFT_PER_M = 50.0
"""Variance that a slope gains for each metre of motion: one of 1 is unknown again after 20 mm, one
of 0.1 after 0.2 mm. Of 0.5 to 500 it hardly matters from here on: on palpation 0.40 to 0.68 of
hold's excess error, 0.72 at 0.5.
"""
UNKNOWN = 1.0
"""Variance of a slope of which nothing is known; that of a tissue as stiff as the coupling is 1."""


class ContactSlope:
    """The matrix S of df = -S dp, force f over the coupling's stiffness and position p both in
    metres, shape (3, 3).

    A random walk of S, corrected by every tick's changes (recursive least squares with a forgetting
    that counts motion, not time, so that what a resting tool has learnt stays). Alike in all
    directions: it turns with the motion.
    """

    def __init__(self) -> None:
        self.matrix = np.zeros((3, 3))
        self._spread = UNKNOWN * np.eye(3)
        self._before: tuple[Array, Array] | None = None

    def observe(self, tip_m: Array, force_m: Array) -> None:
        """Take in a tick of a contact, or of none where the force is zero."""
        if not any(force_m.tolist()):
            self.pause()
            return
        if self._before is not None:
            moved = tip_m - self._before[0]
            changed = force_m - self._before[1]
            if (square := float(moved.dot(moved))) > 0.0:
                along = self._spread.dot(moved)
                gain = along / (NOISE_M**2 + float(moved.dot(along)))
                self.matrix -= (changed + self.matrix.dot(moved))[:, None] * gain
                self._spread -= gain[:, None] * along
                self._spread.flat[::4] += DRIFT_PER_M * sqrt(square)
                self._bound()
        self._before = tip_m.copy(), force_m.copy()

    def pause(self) -> None:
        """What was learnt is a first guess of the next contact."""
        self._before = None
        self._spread = UNKNOWN * np.eye(3)

    def _bound(self) -> None:
        """Keep the spread below that of the unknown; its trace, so that no direction is
        preferred.
        """
        size = sum(self._spread.flat[::4].tolist())
        if size > 3.0 * UNKNOWN:
            self._spread *= 3.0 * UNKNOWN / size


class LookAhead:
    """Goes on along the device's path and asks the contact there: coupling and tissue, both linear
    about the last tick.

    With the coupling's stiffness k, the tool's tip p, the tissue's force f on it and that force's
    slope -df/dp = K, a device at x has the tool where k (x - p') + f - K (p' - p) = 0, and feels k
    (p' - x). Tissue that would pull has let go. A tool that is free comes to the surface by the gap
    that the tissue knows of, if it does, and from there on counts for as stiff as it was last. A
    slope that the tissue does not know is learnt (`ContactSlope`).

    A tool that cuts has no place to go back to: its stretch is what the path foresees. A law of the
    last tick did not serve there: on the operator's path in milling, mixed with the stretch that
    the operator foresees, a tip that stays left 1.3 of the excess error of holding the force, and
    one that goes on 1.6.

    What the coupling's damper adds to the spring now, it adds at the end of the path, too.

    Parameters
    ----------
    path
        What foresees the device's path.
    """

    residual_N = 0.0
    is_primary = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self._slope = ContactSlope()
        self._contact: Contact | None = None
        self._stiffness = np.zeros((3, 3))
        self._unit = np.eye(3)
        self._surface = RIGID
        self._position, self._force, self._damper, self._expected = np.zeros((4, 3))

    @property
    def trusted(self) -> bool:
        """Whether its path is, and whether it was shown a contact."""
        return self._contact is not None and self.path.trusted

    def meet(self, contact: Contact) -> None:
        """Take in the law of this tick."""
        spring = contact.spring_N_m
        self._contact = Contact(
            spring,
            contact.tip_m.copy(),
            contact.force_N / spring,
            None,
            contact.gap_m,
            contact.normal.copy(),
            contact.cuts,
        )
        if contact.cuts:
            return  # no law of the tissue is asked
        force = self._contact.force_N
        touches = any(force.tolist())
        if contact.stiffness_N_m is None:
            self._slope.observe(contact.tip_m, force)
            self._stiffness = self._slope.matrix
        elif touches:
            self._stiffness = contact.stiffness_N_m / spring
        if touches:
            self._surface = max(
                float(force.dot(self._stiffness.dot(force))) / float(force.dot(force)), 0.0
            )

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Take in the device, and the force in ticks in which the tissue has answered."""
        contact = self._contact
        if contact is None:
            if force_N is not None:
                self._force = force_N.copy()
            return
        self._position = position_m.copy()
        if force_N is not None:
            missed = force_N - self._expected
            self.residual_N = sqrt(missed.dot(missed))
            self._force = force_N.copy()
            self._damper[:] = 0.0
            if any(contact.force_N.tolist()) and not contact.cuts:
                self._damper = force_N - contact.spring_N_m * (contact.tip_m - position_m)
        elif not contact.cuts:
            self._force = self._at(position_m)
        else:
            self._force = self._expected
        self.path.observe(position_m, self._force / contact.spring_N_m)
        self._expected = self.predict(1.0)

    def predict(self, ticks: float) -> Array:
        """Force of the law at the end of the path."""
        if ticks == 0.0 or self._contact is None:
            return self._force.copy()
        if self._contact.cuts:
            if not any(self._force.tolist()):
                return np.zeros(3)
            return self._contact.spring_N_m * self.path.stretch_m(ticks) + self._damper
        return self._at(self._position + self.path.displacement_m(ticks))

    def pause(self) -> None:
        """The path and the contact begin anew."""
        self.path.pause()
        self._slope.pause()

    def _at(self, device_m: Array) -> Array:
        """The force on a device that is there [N]."""
        contact = self._contact
        assert contact is not None
        force = contact.force_N
        if any(force.tolist()):
            *_, moved, singular = dgesv(
                self._unit + self._stiffness, device_m - contact.tip_m + force
            )
            left = force - self._stiffness.dot(moved)
            if singular or float(left.dot(force)) <= 0.0:
                return np.zeros(3)
            felt: Array = contact.spring_N_m * (contact.tip_m + moved - device_m) + self._damper
            return felt
        if not isfinite(contact.gap_m):
            return np.zeros(3)
        overlap = -(contact.gap_m + float(contact.normal.dot(device_m - contact.tip_m)))
        stiffness = contact.spring_N_m * self._surface / (1.0 + self._surface)
        return max(overlap, 0.0) * stiffness * contact.normal
