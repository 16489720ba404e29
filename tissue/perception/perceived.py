"""Scaling of the force for a person in each tick, and simulation of the person's perception."""

from math import exp, inf, sqrt
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.laws import D_PRIME_75, ForceMap, Weber


class Perception(Protocol):
    """Interface of perception models.

    A perception model computes the force that a device must play so that a person perceives the
    wanted force. It does not change the direction of the force. `step` is called once in each tick
    and takes microseconds.
    """

    estimated_N: float
    """Person's current estimate of the felt force [N]."""
    perceived: float
    """Mean perceived intensity of the played force; unit: reference observer's intensity at 1 N."""
    perceived_spread: float
    """Standard deviation of the perceived intensity of the played force."""
    steepest: float
    """Largest slope of the played force over the given force, for the stability check."""
    sentence: str
    """Sentence on the observer and the scaling that is reported before a run."""
    above: bool
    """True if the last change of the force was above the person's threshold and was played."""

    def step(self, force_N: Array) -> Array:
        """Return the force to play [N], shape (3,), instead of the simulated force `force_N`."""
        ...

    def pause(self) -> None:
        """Reset after a missing sample, and play the next force even if its change is small."""
        ...


class PerceptionMaker(Protocol):
    """Function that makes a perception model for a device."""

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
            Random generator for the noise of the person's perception.
        force_limit_N, friction_N
            Largest force of the device, and Coulomb friction of the device [N].
        tick_s
            Time between two calls of `step` [s].
        """
        ...


REST_SHARE = 0.5
"""Ratio of a force to the threshold at zero force, below which the played force becomes zero.

The played force becomes zero below half of this threshold, and becomes non-zero again above the
whole threshold. Noise near one of the two limits therefore does not switch the force on and off.
"""
BLOCK = 512
"""Number of ticks for which random numbers are drawn at once.

Drawing takes 0.9 us for a single number, and 0.13 us for each number in a block. A block of 512
numbers takes 70 us in one tick.
"""


class Deadband:
    """Deadband that holds a vector until the wanted vector differs by more than a threshold.

    The vectors are forces, for example. If the distance between played and wanted vector exceeds
    the threshold, the wanted vector is played. The threshold depends on the magnitude of the played
    vector.

    The distance includes changes of direction and of magnitude. The error does not accumulate:
    after every tick, the played vector is within the threshold of the wanted vector. Noise smaller
    than the threshold does not change the played vector.

    A wanted vector that is shorter than half the threshold at zero magnitude is played as zero, so
    that no force acts in free space.

    While the played force stays constant and the wanted force decreases, the device receives
    energy. In one cycle of pressing and releasing, this energy equals the loss by a Coulomb
    friction of half the threshold. This energy is dissipated by the friction of the device if this
    friction exceeds half the threshold, otherwise by the damping of a hand.

    Parameters
    ----------
    law
        Threshold as a function of the magnitude of the played vector.
    widest
        Upper bound of the threshold, in the unit of the vectors; 0 or more.

    Attributes
    ----------
    held
        Vector that is played, shape (3,).
    changed
        True if the last step changed `held`.
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
        """Play the next vector, and count it as a change, even if it is within the threshold."""
        self._fresh = True


class Sense:
    """Model of a person's estimate of a force: noisy observations, averaged by a filter.

    The person observes the force once in each tick. The filter has the constant gain G = 1 - exp(-T
    / tau), where T is the duration of a tick, and tau is the time over which a person averages
    force. The estimate of a constant force has the standard deviation s. The value of s is such
    that a change of the force by one threshold has the sensitivity d' = 0.954. For this s, an
    observation must have the variance r = s^2 (2 - G) / G. The filter is the Kalman filter for a
    random walk of the force with the variance q = G^2 r / (1 - G) per tick.

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
    """Perception model for one observer: force map, deadband, and model of the person's estimate.

    Parameters
    ----------
    law
        Map from a force to the command (the force to play). It also holds the perceived intensity
        of a command.
    deadband
        Deadband that keeps the command constant until the person can feel a change.
    sense
        Model of the person's estimate of the command.
    sentence
        Sentence on the observer and the scaling that is reported before a run.

    Attributes
    ----------
    steepest
        Largest derivative of the command with respect to the force. The stability check multiplies
        the stiffness of a virtual wall by this slope.
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
        """Return the force to play [N], shape (3,); the next step overwrites this array.

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
        """Reset after a missing sample, and play the next force even if its change is small."""
        self.deadband.forget()
        self.above = False
