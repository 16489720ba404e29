"""Perceptual scaling in each tick: force map, deadband, and estimate of the force by a person."""

from math import exp, inf, sqrt
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.laws import D_PRIME_75, ForceMap, Weber


class Perception(Protocol):
    """Perception model that computes the force to play on the device for one observer.

    The direction of the force is kept. `step` is called once a tick and takes microseconds.
    """

    estimated_N: float
    """Observer's estimate of the felt force, after the recursive update [N]."""
    perceived: float
    """Mean intensity of the commanded force, relative to the reference observer at 1 N."""
    perceived_spread: float
    """Standard deviation of the intensity of the commanded force."""
    steepest: float
    """Largest slope of the command over the force; the stability check includes this factor."""
    sentence: str
    """Description of the observer and of the scaling, reported before a run."""
    above: bool
    """True if the last change was above the observer's threshold and was rendered."""

    def step(self, force_N: Array) -> Array:
        """Return the force to command [N] for a force at the device [N], each of shape (3,)."""
        ...

    def pause(self) -> None:
        """Reset after a missing sample: play the next force, even if it is below the threshold."""
        ...


class PerceptionMaker(Protocol):
    """Factory of perception models for a device."""

    def __call__(
        self,
        argument: str,
        *,
        rng: np.random.Generator,
        force_limit_N: float,
        tick_s: float,
        friction_N: float,
    ) -> Perception:
        """Return a new perception model.

        Parameters
        ----------
        argument
            Text after the colon in a name such as ``observer:FILE``; empty without a colon.
        rng
            Random generator for the noise of the observer's sense.
        force_limit_N, friction_N
            Largest force and Coulomb friction of the device [N].
        tick_s
            Time between two steps [s].
        """
        ...


REST_SHARE = 0.5
"""Ratio of a force to the threshold at zero force, below which zero force is played.

The played force becomes zero below half of the threshold. It becomes non-zero again above the whole
threshold. Noise around one of the two values therefore does not switch the force on and off.
"""
BLOCK = 512
"""Number of ticks whose random numbers are drawn at once.

A number takes 0.9 us if it is drawn alone, and 0.13 us in a block. A block of 512 takes 70 us in
one tick.
"""


class Deadband:
    """Deadband that changes the played vector only if the wanted vector is far enough from it.

    If the distance between the two vectors exceeds a threshold, the wanted vector is played. The
    threshold is evaluated at the magnitude of the played vector.

    The distance is a distance of vectors, so that it includes changes of direction and of
    magnitude. At a change the wanted vector itself is played, and not a sum of steps. Errors
    therefore cannot accumulate: in every tick the error is below the threshold. Noise within the
    threshold is not played.

    A vector shorter than half of the threshold at zero is played as zero, so that there is no force
    in free space.

    If the played force is constant while the wanted force decreases, the device receives energy. In
    a cycle, this energy equals the energy that a Coulomb friction of half the threshold would
    dissipate. A larger friction of the device, or the damping of a hand, dissipates the received
    energy.

    Parameters
    ----------
    law
        Threshold as a function of the magnitude.
    widest
        Upper bound of the threshold, in the unit of the vector; 0 or more.

    Attributes
    ----------
    held
        Vector that is played, shape (3,).
    changed
        True if the last wanted vector exceeded the threshold and is played.
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
        """Update with the wanted vector; return True if `held` changed."""
        size = sqrt(x * x + y * y + z * z)
        if rest := size < REST_SHARE * self._least:
            x = y = z = size = 0.0
        a, b, c = self._held
        self.changed = (
            self._fresh
            or (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 > self._allowed * self._allowed
        )
        # A wanted force of zero is played even if it is within the threshold of the played force.
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
        """Play the next vector as a change, even if its distance is below the threshold."""
        self._fresh = True


def held_back(wanted: Array, law: Weber) -> tuple[Array, Array]:
    """Apply a deadband to recorded vectors, shape (n, 3).

    Return the played vectors, shape (n, 3), and a mask of the changes, shape (n,).
    """
    deadband = Deadband(law)
    played = np.empty_like(wanted, dtype=float)
    changes = np.zeros(len(wanted), dtype=bool)
    for tick, vector in enumerate(np.asarray(wanted, dtype=float).tolist()):
        changes[tick] = deadband.step(*vector)
        played[tick] = deadband.held
    return played, changes


class Sense:
    """Estimate of a force by a person: noisy observations, averaged by a filter with constant gain.

    The person observes the force once a tick. The gain is G = 1 - exp(-T / tau), where T is the
    tick, and tau is the time over which the person averages force. The noise of an observation is
    chosen so that the scatter s of the estimate of a constant force corresponds to the threshold:
    for a change of one threshold, d' is 0.954. With this gain and scatter, an observation has the
    variance r = s^2 (2 - G) / G. The filter assumes a random walk of the force with the variance q
    = G^2 r / (1 - G) per tick.

    Attributes
    ----------
    force_N
        Estimate of the force's magnitude [N], 0 or more.
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
    """Perception model that implements `tissue.perception.perceived.Perception`.

    Parameters
    ----------
    law
        Map from force to command, and intensity of a command.
    deadband
        Deadband: the command is constant until a change can be felt.
    sense
        Observer's estimate of the command.
    sentence
        Description of the observer and of the scaling, reported before a run.

    Attributes
    ----------
    steepest
        Largest slope of the command as a function of force. In the stability check, the stiffness
        of a virtual wall is multiplied by this slope.
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
        """Return the force to command [N], shape (3,); the next step overwrites this array.

        Raises
        ------
        InputError
            If the force is not finite. In this case, the state is not changed.
        """
        x, y, z = force_N.tolist()
        size = sqrt(x * x + y * y + z * z)
        if not size < inf:
            raise InputError(
                "force", "be finite", force_N, "use a SampleGuard, which removes such samples"
            )
        # A force of zero has no direction; any factor gives zero.
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
        """Reset after a missing sample: play the next force, even if it is below the threshold."""
        self.deadband.forget()
        self.above = False
