"""Force of the tissue's own law at the predicted device position.

Where the tissue gives no slope of its law, the slope is learnt in contact.
"""

from math import isfinite, sqrt
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.prediction.predictor import Contact, kalman_gains

__all__ = ["ContactSlope", "FilteredPath", "LookAhead", "Path"]

JERKINESS = 3e-5
"""Variance of the position's third difference over the variance of its noise.

Of 1e-6 to 1e-3 it is the best value on the wall and on palpation together: 1e-4 for the wall and
1e-5 for palpation alone.
"""

RIGID = 1e3
"""Stiffness, over the coupling's, of a nearby tissue that has not been touched yet."""
NOISE_M = 1e-6
"""Deviation of a force, over the coupling's stiffness, from a linear law in a tick [m].

Its causes are curvature and friction.
"""
DRIFT_PER_M = 50.0
"""Increase of a slope's variance per metre of motion.

A slope of 1 is unknown again after 20 mm, a slope of 0.1 after 0.2 mm. Of 0.5 to 500, values from
50 on differ little: on palpation they leave 0.40 to 0.68 of the excess error of the zero-order
hold, and 0.5 leaves 0.72.
"""
UNKNOWN = 1.0
"""Variance of an unknown slope; the slope is 1 for a tissue as stiff as the coupling."""


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

    def __init__(self) -> None:
        self._gains = kalman_gains(1, JERKINESS)[:, None]
        # Position, velocity and acceleration one tick later, in units of ticks.
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


class ContactSlope:
    """Estimate of the matrix S of df = -S dp, shape (3, 3).

    The force f is divided by the coupling's stiffness, so f and the position p are both in metres.

    S is a random walk, corrected by the changes of every tick (recursive least squares). Forgetting
    counts motion, not time, so the estimate of a resting tool stays. No direction is preferred: the
    estimate turns with the motion.
    """

    def __init__(self) -> None:
        self.matrix = np.zeros((3, 3))
        self._spread = UNKNOWN * np.eye(3)
        self._before: tuple[Array, Array] | None = None

    def observe(self, tip_m: Array, force_m: Array) -> None:
        """Update with a tick in contact; a zero force ends the contact."""
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
                # every fourth entry of a 3 x 3 matrix: its diagonal
                self._spread.flat[::4] += DRIFT_PER_M * sqrt(square)
                self._bound()
        self._before = tip_m.copy(), force_m.copy()

    def pause(self) -> None:
        """Keep the estimate as a first guess for the next contact."""
        self._before = None
        self._spread = UNKNOWN * np.eye(3)

    def _bound(self) -> None:
        """Limit the spread to the spread of an unknown slope.

        Its trace is limited, so that no direction is preferred.
        """
        size = sum(self._spread.flat[::4].tolist())
        # trace of UNKNOWN times the unit matrix
        if size > 3.0 * UNKNOWN:
            self._spread *= 3.0 * UNKNOWN / size


class LookAhead:
    """Force at the predicted device position, from linearised coupling and tissue.

    Both are linear about the last tick.

    With the coupling's stiffness k, the tool's tip p, the tissue's force f on it and that force's
    slope -df/dp = K, a device at x has its tool at p', where k (x - p') + f - K (p' - p) = 0.
    The force on the device is k (p' - x). A tissue force that would pull is replaced by zero. A
    free tool reaches the surface after the gap that the tissue provides. Beyond the surface the
    tissue has the stiffness of the last contact. If the tissue provides no slope, the slope is
    learnt (`ContactSlope`).

    A cutting tool is not pushed back, so its stretch is the stretch that the path predicts. A law
    of the last tick did not work there. On the operator's path in milling, mixed with the
    operator's stretch, a tip that stays left 1.3 of the excess error of the zero-order hold. A tip
    that moves on left 1.6.

    The coupling's damper force is assumed constant up to the end of the path.

    Parameters
    ----------
    path
        Predictor of the device's path.
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
        """True if the path is trusted and a contact is known."""
        return self._contact is not None and self.path.trusted

    def meet(self, contact: Contact) -> None:
        """Store the contact law of this tick."""
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
            return  # the law of the tissue is not used
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
        """Update with the device, and with the force in ticks with a tissue answer."""
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
        """Return the force of the contact law at the end of the path."""
        if ticks == 0.0 or self._contact is None:
            return self._force.copy()
        if self._contact.cuts:
            if not any(self._force.tolist()):
                return np.zeros(3)
            return self._contact.spring_N_m * self.path.stretch_m(ticks) + self._damper
        return self._at(self._position + self.path.displacement_m(ticks))

    def pause(self) -> None:
        """Reset the path and the contact."""
        self.path.pause()
        self._slope.pause()

    def _at(self, device_m: Array) -> Array:
        """Return the force on a device at a position [N]."""
        contact = self._contact
        assert contact is not None
        force = contact.force_N
        if any(force.tolist()):
            *_, moved, singular = dgesv(
                self._unit + self._stiffness, device_m - contact.tip_m + force
            )
            left = force - self._stiffness.dot(moved)
            # Tissue does not pull: the contact has ended.
            if singular or float(left.dot(force)) <= 0.0:
                return np.zeros(3)
            felt: Array = contact.spring_N_m * (contact.tip_m + moved - device_m) + self._damper
            return felt
        # No surface is near the tool.
        if not isfinite(contact.gap_m):
            return np.zeros(3)
        overlap = -(contact.gap_m + float(contact.normal.dot(device_m - contact.tip_m)))
        # coupling and tissue in series
        stiffness = contact.spring_N_m * self._surface / (1.0 + self._surface)
        return max(overlap, 0.0) * stiffness * contact.normal
