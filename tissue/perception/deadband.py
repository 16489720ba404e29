"""A force is played on unchanged until its change can be felt."""

from math import inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.perception.weber import Weber

__all__ = ["Deadband", "held_back"]

REST_SHARE = 0.5
"""Share of the smallest force that can be felt at all, below which zero is played."""


class Deadband:
    """Holds a vector while its distance to the wanted one is under the threshold at the held size; then takes the new.

    The distance is that of vectors, so turning counts as well as growing. What is played is the wanted vector itself
    whenever it changes, never a sum of steps, so that errors cannot accumulate: at every tick the error is below the
    threshold. Noise that stays within the threshold of what is held is not played at all.

    What is weaker than half of what can be felt from nothing is played as zero, so that nothing pulls in free air.

    A force that is held while it should fall gives energy to the device: over a cycle as much as a Coulomb friction of
    half the threshold with the wrong sign. A friction of more than that in the device, or the damping of a hand, pays.

    Parameters
    ----------
    law
        Threshold of the size.
    widest
        What the distance never exceeds, in the unit of the vector, however great the threshold; at least 0.

    Attributes
    ----------
    held
        What is played, shape (3,).
    changed
        Whether the last vector was far enough from what was held, and so is played.
    """

    def __init__(self, law: Weber, *, widest: float = inf) -> None:
        self._widest = widest
        self._kappa, self._least = law.kappa, law.kappa * law.offset
        self._held, self._allowed = (0.0, 0.0, 0.0), min(self._least, widest)
        self._fresh = True
        self.held: Array = np.zeros(3)
        self.changed = False

    def step(self, x: float, y: float, z: float) -> bool:
        """Take the wanted vector in; whether `held` is another now."""
        size = sqrt(x * x + y * y + z * z)
        if rest := size < REST_SHARE * self._least:
            x = y = z = size = 0.0
        a, b, c = self._held
        self.changed = self._fresh or (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 > self._allowed * self._allowed
        if not (self.changed or (rest and (a or b or c))):
            return False
        self._fresh = False
        self._held = x, y, z
        self._allowed = min(self._kappa * size + self._least, self._widest)
        self.held[0], self.held[1], self.held[2] = x, y, z
        return True

    def forget(self) -> None:
        """The next vector counts as a change."""
        self._fresh = True


def held_back(wanted: Array, law: Weber) -> tuple[Array, Array]:
    """A recorded sequence of vectors, shape (n, 3), as a deadband plays it, and where it changed, shape (n,)."""
    deadband = Deadband(law)
    played, changes = np.empty_like(wanted, dtype=float), np.zeros(len(wanted), dtype=bool)
    for tick, vector in enumerate(np.asarray(wanted, dtype=float).tolist()):
        changes[tick] = deadband.step(*vector)
        played[tick] = deadband.held
    return played, changes
