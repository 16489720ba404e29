"""Force prediction from the predicted device position and a local law of the tissue.

The law is linear. If the tissue does not provide its stiffness (the slope), the slope is estimated
during contact.
"""

from math import isfinite, sqrt

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.prediction.delays import DelayPath
from tissue.prediction.predictor import Contact

NOISE_M = 1e-6
"""Deviation of the force from a linear law in a tick, divided by the coupling stiffness [m].

The deviation is caused by the curvature of the law and by friction.
"""
DRIFT_PER_M = 50.0
"""Increase of the variance of an estimated slope per metre of motion.

A slope is the stiffness of the tissue divided by the stiffness of the coupling. A slope counts as
unknown when its variance reaches the square of the slope. A slope of 1 is unknown after 20 mm of
motion, and a slope of 0.1 after 0.2 mm. Values from 0.5 to 500 were compared in the scene
palpation, by the error ratio that is defined in `tissue.prediction.delays`. With values from 50 on,
the error ratios are similar: 0.40 to 0.68. With a value of 0.5, the error ratio is 0.72.
"""
JUMP_M = 5e-4
"""Change of force in a tick that counts as a jump, divided by the coupling stiffness [m].

The value corresponds to a device speed of 0.5 m/s against a rigid tissue. No hand moves so fast.
"""
UNKNOWN = 1.0
"""Variance of an unknown slope.

A tissue as stiff as the coupling has a slope of 1.
"""


class ContactSlope:
    """Estimate of the slope S of a contact force, shape (3, 3), defined by df = -S dp.

    Here p is the position of the tool [m], and f is the force divided by the coupling's stiffness
    [m].

    S is modelled as a random walk, and is corrected in every tick with the changes of p and f
    (recursive least squares). The variance of S increases with the motion and not with time, so
    that the estimate does not change while the tool rests. The estimate has no preferred direction:
    for a rotated motion, the result is a rotated estimate.
    """

    def __init__(self) -> None:
        self.matrix = np.zeros((3, 3))
        self._spread = UNKNOWN * np.eye(3)
        self._before: tuple[Array, Array] | None = None

    def observe(self, tip_m: Array, force_m: Array) -> None:
        """Update with the position and the force in a tick; a zero force ends the contact."""
        if not any(force_m.tolist()):
            self.pause()
            return
        if self._before is not None:
            moved = tip_m - self._before[0]
            changed = force_m - self._before[1]
            is_jump = changed.dot(changed) > JUMP_M**2
            if (square := moved.dot(moved)) > 0.0 and not is_jump:
                along = self._spread.dot(moved)
                gain = along / (NOISE_M**2 + moved.dot(along))
                self.matrix -= (changed + self.matrix.dot(moved))[:, None] * gain
                self._spread -= gain[:, None] * along
                # every fourth entry of a 3 x 3 matrix is on its diagonal
                self._spread.flat[::4] += DRIFT_PER_M * sqrt(square)
                self._bound()
        self._before = tip_m.copy(), force_m.copy()

    def pause(self) -> None:
        """Keep the estimate as a first guess for the next contact."""
        self._before = None
        self._spread = UNKNOWN * np.eye(3)

    def _bound(self) -> None:
        """Limit the variance to the variance of an unknown slope.

        The trace of the covariance is limited, so that no direction is preferred.
        """
        size = sum(self._spread.flat[::4].tolist())
        # trace of UNKNOWN times the unit matrix
        if size > 3.0 * UNKNOWN:
            self._spread *= 3.0 * UNKNOWN / size


class LookAhead:
    """Predictor that balances coupling and tissue forces at the predicted device position.

    The forces of coupling and tissue are linearised about the last tick.

    Let k be the coupling's stiffness, p the tip of the tool, f the force of the tissue on the tool,
    and K = -df/dp the slope of f. If the device is at x, the tool moves to the point p' where the
    forces balance: k (x - p') + f - K (p' - p) = 0. The force on the device is then k (p' - x). A
    tissue force that would pull the tool is replaced by zero. For a free tool, the tissue may
    provide the distance to its surface and the stiffness of the surface. These values give the
    force after contact. If the tissue provides no slope, the slope is estimated (`ContactSlope`).

    For a cutting tool, the predicted force is the coupling's predicted stretch times the coupling's
    stiffness. Using the law of the cutting force does not improve this prediction; see
    ``docs/decisions.md``.

    The damper force of the coupling is assumed to be constant during the predicted time.

    Parameters
    ----------
    path
        Predictor of the device's displacement and the coupling's stretch.
    slopes
        Source of the slope of the tissue force. ``none`` uses no slope. ``given`` uses the slopes
        that the tissue provides. ``learnt`` uses these slopes, and estimates slopes that the tissue
        does not provide. In a contact without a slope, such as friction and rupture under a needle
        or a blade, the predicted stretch of the coupling gives the force. At the start of such a
        contact, no past stretch is known. The force is then computed from the stiffness of the
        surface below the tool. The weight of this force falls from 1 to 0 within the prediction
        horizon.
    """

    residual_N = 0.0
    is_primary = True

    def __init__(self, path: DelayPath, *, slopes: str = "learnt") -> None:
        self.path = path
        self._slopes = slopes
        self._has_slope = False
        self._slope = ContactSlope()
        self._contact: Contact | None = None
        self._stiffness = np.zeros((3, 3))
        self._unit = np.eye(3)
        self._position = np.zeros(3)
        self._force = np.zeros(3)
        self._damper = np.zeros(3)
        self._expected = np.zeros(3)
        # Number of ticks since the contact began.
        self._age = 0

    @property
    def trusted(self) -> bool:
        """True if the prediction of the motion is trusted and contact data were received."""
        return self._contact is not None and self.path.trusted

    def meet(self, contact: Contact) -> None:
        """Store the local law of the tissue that is valid in this tick."""
        spring = contact.spring_N_m
        self._contact = Contact(
            spring,
            contact.tip_m.copy(),
            contact.force_N / spring,
            None,
            contact.gap_m,
            contact.normal.copy(),
            contact.surface_N_m,
            contact.cuts,
        )
        if contact.cuts:
            return
        force = self._contact.force_N
        given = contact.stiffness_N_m is not None
        self._has_slope = self._slopes == "learnt" or (given and self._slopes == "given")
        if contact.stiffness_N_m is None:
            self._slope.observe(contact.tip_m, force)
            self._stiffness = self._slope.matrix
        elif any(force.tolist()):
            self._stiffness = contact.stiffness_N_m / spring

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the device position and, if the tissue has responded, with the force."""
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
            self._age = self._age + 1 if any(self._force.tolist()) else 0
            self._damper[:] = 0.0
            if any(contact.force_N.tolist()) and not contact.cuts:
                self._damper = force_N - contact.spring_N_m * (contact.tip_m - position_m)
        elif not contact.cuts:
            self._force = self._at(position_m)
        else:
            self._force = self._expected
        stretch = self._force / contact.spring_N_m
        # The device position that the tool follows; with a filter it is not the measured position.
        filtered = None
        if contact.cuts and force_N is not None:
            filtered = contact.tip_m - stretch
        self.path.observe(position_m, stretch, filtered)
        self._expected = self._next(contact)

    def _next(self, contact: Contact) -> Array:
        """Return the force expected in the next tick.

        For a tool that cuts, the force is computed from the predicted stretch only.
        """
        if not contact.cuts:
            return self.predict(1.0)
        return contact.spring_N_m * self.path.stretch_m(1.0)

    def predict(self, ticks: float) -> Array:
        """Return the force for the predicted device position."""
        if ticks == 0.0 or self._contact is None:
            return self._force.copy()
        if self._contact.cuts:
            if not any(self._force.tolist()):
                return np.zeros(3)
            return self._contact.spring_N_m * self.path.stretch_m(ticks)
        if not self._has_slope and any(self._force.tolist()):
            predicted = self._contact.spring_N_m * self.path.stretch_m(ticks)
            if self._age <= ticks and isfinite(self._contact.surface_N_m):
                # A contact that is younger than the prediction has no past stretch.
                share = 1.0 - self._age / (ticks + 1.0)
                predicted += share * (self._pressed(self._contact, ticks) - predicted)
            # Tissue does not pull: the contact has ended.
            return predicted if predicted.dot(self._force) > 0.0 else np.zeros(3)
        return self._at(self._position + self.path.displacement_m(ticks))

    def _pressed(self, contact: Contact, ticks: float) -> Array:
        """Return the force [N] after a predicted motion into the surface, along its normal."""
        depth = -contact.normal.dot(self.path.displacement_m(ticks))
        stiffness = _in_series(contact.spring_N_m, contact.surface_N_m)
        return self._force + stiffness * depth * contact.normal

    def pause(self) -> None:
        """Discard previous samples, and keep the slope as a first guess for the next contact."""
        self.path.pause()
        self._slope.pause()

    def _at(self, device_m: Array) -> Array:
        """Return the force [N] on the device at the position ``device_m``."""
        contact = self._contact
        assert contact is not None
        force = contact.force_N
        if any(force.tolist()):
            *_, moved, singular = dgesv(
                self._unit + self._stiffness, device_m - contact.tip_m + force
            )
            left = force - self._stiffness.dot(moved)
            # Tissue does not pull: the contact has ended.
            if singular or left.dot(force) <= 0.0:
                return np.zeros(3)
            felt: Array = contact.spring_N_m * (contact.tip_m + moved - device_m) + self._damper
            return felt
        # No surface is near the tool.
        if not isfinite(contact.gap_m):
            return np.zeros(3)
        overlap = -(contact.gap_m + contact.normal.dot(device_m - contact.tip_m))
        stiffness = _in_series(contact.spring_N_m, contact.surface_N_m)
        return max(overlap, 0.0) * stiffness * contact.normal


def _in_series(spring_N_m: float, surface_N_m: float) -> float:
    """Return the stiffness of coupling and tissue in series [N/m]."""
    return 1.0 / (1.0 / spring_N_m + 1.0 / surface_N_m)
