"""Interface of a perceptual model of the observer."""

from typing import Protocol

import numpy as np

from meshes.base.arrays import Array

__all__ = ["Perception", "PerceptionMaker"]


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
