"""Perceptual scaling in each tick: force map, deadband, and a person's estimate of the force."""

from math import exp, inf, sqrt
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.laws import D_PRIME_75, ForceMap, Weber

__all__ = ["Deadband", "PerceivedForce", "Perception", "PerceptionMaker", "Sense", "held_back"]


class Perception(Protocol):
    """Map from a force to be felt to the force to command, for one observer.

    The direction does not change. `step` is called once a tick and costs microseconds.
    """

    estimated_N: float
    """Estimate of the force that the observer feels, after the recursive update [N]."""
    perceived: float
    """Mean intensity of the commanded force, in units of the reference observer's."""
    perceived_spread: float
    """Standard deviation of the intensity of the commanded force."""
    steepest: float
    """Largest slope of command over force, a factor on the stiffness of a wall for stability."""
    sentence: str
    """Description of the observer and of the scaling, reported before a run."""
    above: bool
    """True if the last change was above the observer's threshold, and so was rendered."""

    def step(self, force_N: Array) -> Array:
        """Return the force to command [N] for a force at the device [N], shapes (3,)."""
        ...

    def pause(self) -> None:
        """Reset after a missing sample: command nothing, and count the next force as a change."""
        ...


class PerceptionMaker(Protocol):
    """Factory of perceptual scalings for a device."""

    def __call__(
        self,
        argument: str,
        *,
        rng: np.random.Generator,
        force_limit_N: float,
        tick_s: float,
        friction_N: float,
    ) -> Perception:
        """Return a new perception.

        Parameters
        ----------
        argument
            Text after the colon of a name such as ``observer:FILE``; empty without a colon.
        rng
            Random generator of the noise in the observer's sense.
        force_limit_N, friction_N
            Largest force and Coulomb friction of the device [N].
        tick_s
            Time between two steps [s].
        """
        ...


REST_SHARE = 0.5
"""Share of the threshold at zero below which zero is played.

A force returns to zero at half of the threshold and leaves zero at all of it. Noise around one of
the two values therefore does not switch the force on and off.
"""
BLOCK = 512
"""Number of ticks whose random numbers are drawn at once.

One number costs 0.9 us alone and 0.13 us in a block. A block of 512 costs 70 us in one tick.
"""


class Deadband:
    """Deadband: keep the held vector until its distance to the wanted vector exceeds the threshold.

    The threshold is evaluated at the held size. Then the wanted vector is taken.

    The distance is that of vectors, so a change of direction counts as well as a change of size. At
    a change the wanted vector itself is played, never a sum of steps, so errors cannot accumulate:
    at every tick the error is below the threshold. Noise within the threshold of the held vector is
    not played at all.

    A vector below half of the threshold at zero is played as zero, so that no force pulls in free
    air.

    A force that is held while it should fall gives energy to the device. Over a cycle it gives the
    energy of a Coulomb friction of half the threshold with the wrong sign. A larger friction of the
    device, or the damping of a hand, dissipates it.

    Parameters
    ----------
    law
        Threshold of the size.
    widest
        Upper bound of the distance, in the unit of the vector, for any threshold; 0 or more.

    Attributes
    ----------
    held
        Vector that is played, shape (3,).
    changed
        True if the last vector was beyond the threshold, and so is played.
    """

    def __init__(self, law: Weber, *, widest: float = inf) -> None:
        self._widest = widest
        self._kappa = law.kappa
        self._least = law.kappa * law.offset
        self._held = (0.0, 0.0, 0.0)
        self._allowed = min(self._least, widest)
        self._fresh = True
        self.held: Array = np.zeros(3)
        self.changed = False

    def step(self, x: float, y: float, z: float) -> bool:
        """Update with the wanted vector; return True if `held` has changed."""
        size = sqrt(x * x + y * y + z * z)
        if rest := size < REST_SHARE * self._least:
            x = y = z = size = 0.0
        a, b, c = self._held
        self.changed = (
            self._fresh
            or (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 > self._allowed * self._allowed
        )
        # A wanted force of zero is played although it is within the threshold of the held force.
        if not (self.changed or (rest and (a or b or c))):
            return False
        self._fresh = False
        self._held = x, y, z
        self._allowed = min(self._kappa * size + self._least, self._widest)
        self.held[0] = x
        self.held[1] = y
        self.held[2] = z
        return True

    def forget(self) -> None:
        """Count the next vector as a change."""
        self._fresh = True


def held_back(wanted: Array, law: Weber) -> tuple[Array, Array]:
    """Apply a deadband to recorded vectors, shape (n, 3).

    Return the played vectors and a mask of the changes, shape (n,).
    """
    deadband = Deadband(law)
    played = np.empty_like(wanted, dtype=float)
    changes = np.zeros(len(wanted), dtype=bool)
    for tick, vector in enumerate(np.asarray(wanted, dtype=float).tolist()):
        changes[tick] = deadband.step(*vector)
        played[tick] = deadband.held
    return played, changes


class Sense:
    """Estimate of a force by a person: noisy observations, averaged by the steady filter.

    The person observes the force once a tick. The gain 1 - exp(-T / tau) follows from the time over
    which force is averaged. The noise of an observation makes the estimate of a constant force
    scatter by the threshold: a change of one threshold is d' = 0.954 from no change. For this gain
    G and scatter s an observation has the variance r = s^2 (2 - G) / G, and the filter assumes that
    the force wanders by q = G^2 r / (1 - G) a tick.

    Attributes
    ----------
    force_N
        The estimate [N]; a size, never below 0.
    """

    def __init__(
        self, law: Weber, *, integration_s: float, tick_s: float, rng: np.random.Generator
    ) -> None:
        self.gain = 1.0 - exp(-tick_s / integration_s)
        self._kappa = law.kappa
        self._offset = law.offset
        self._noise_ratio = sqrt((2.0 - self.gain) / self.gain) / D_PRIME_75
        self._rng = rng
        self._drawn = list[float]()
        self._level = self.force_N = 0.0

    def step(self, force_N: float) -> float:
        """Observe a force [N] once and return the new estimate."""
        if not self._drawn:
            self._drawn = self._rng.standard_normal(BLOCK).tolist()
        seen = (
            force_N + self._noise_ratio * self._kappa * (force_N + self._offset) * self._drawn.pop()
        )
        self._level += self.gain * (seen - self._level)
        self.force_N = self._level if self._level > 0.0 else 0.0
        return self.force_N


class PerceivedForce:
    """Perceptual scaling that implements `tissue.perception.perceived.Perception`.

    Parameters
    ----------
    law
        Command for a force, and the intensity of a command.
    deadband
        Deadband that holds the command until its change can be felt.
    sense
        The observer's estimate of the command.
    sentence
        Description of the observer and of the scaling, reported before a run.

    Attributes
    ----------
    steepest
        Largest slope of command over force. For stability, the stiffness of a wall is multiplied by
        this factor.
    """

    def __init__(self, law: ForceMap, deadband: Deadband, sense: Sense, *, sentence: str) -> None:
        self.sentence = sentence
        self.steepest = law.steepest
        self.law = law
        self.deadband = deadband
        self.sense = sense
        self.estimated_N = self.perceived = self.perceived_spread = self._size = 0.0
        self.above = False

    def step(self, force_N: Array) -> Array:
        """Return the force to command [N], shape (3,); the array is overwritten by the next step.

        Raises
        ------
        InputError
            If the force is not finite; nothing has changed then.
        """
        x, y, z = force_N.tolist()
        size = sqrt(x * x + y * y + z * z)
        if not size < inf:
            raise InputError(
                "force", "be finite", force_N, "use a SampleGuard, which removes such samples"
            )
        # Zero has no direction: any factor leaves it zero.
        share = self.law.table.at(size) / size if size > 0.0 else 1.0
        deadband = self.deadband
        if deadband.step(share * x, share * y, share * z):
            a, b, c = deadband.held.tolist()
            self._size = sqrt(a * a + b * b + c * c)
            self.perceived = self.law.intensity.at(self._size)
            self.perceived_spread = self.law.spread.at(self._size)
        self.above = deadband.changed
        self.estimated_N = self.sense.step(self._size)
        return deadband.held

    def pause(self) -> None:
        """Reset after a missing sample: command nothing, and count the next force as a change."""
        self.deadband.forget()
        self.above = False
