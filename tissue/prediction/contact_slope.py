"""How a tissue's force changes with the tool's position, learnt from the ticks of a contact."""

from math import sqrt

import numpy as np

from meshes.base.arrays import Array

__all__ = ["ContactSlope"]

NOISE_M = 1e-6
"""What a force, over the coupling's stiffness, is off a linear law in a tick [m]: curvature and friction."""
DRIFT_PER_M = 50.0
"""Variance that a slope gains for each metre of motion: one of 1 is unknown again after 20 mm, one of 0.1 after 0.2 mm.
Of 0.5 to 500 it hardly matters from here on: on palpation 0.40 to 0.68 of hold's excess error, 0.72 at 0.5."""
UNKNOWN = 1.0
"""Variance of a slope of which nothing is known; that of a tissue as stiff as the coupling is 1."""


class ContactSlope:
    """The matrix S of df = -S dp, force f over the coupling's stiffness and position p both in metres, shape (3, 3).

    A random walk of S, corrected by every tick's changes (recursive least squares with a forgetting that counts motion,
    not time, so that what a resting tool has learnt stays). Alike in all directions: it turns with the motion.
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
            moved, changed = tip_m - self._before[0], force_m - self._before[1]
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
        self._before, self._spread = None, UNKNOWN * np.eye(3)

    def _bound(self) -> None:
        """Keep the spread below that of the unknown; its trace, so that no direction is preferred."""
        size = sum(self._spread.flat[::4].tolist())
        if size > 3.0 * UNKNOWN:
            self._spread *= 3.0 * UNKNOWN / size
