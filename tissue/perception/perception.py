"""Contract of a perceptual model of the person who feels."""

from typing import Protocol

import numpy as np

from meshes.base.arrays import Array

__all__ = ["Perception", "PerceptionMaker"]


class Perception(Protocol):
    """Turns a force that shall be felt into the force to command, for one observer; direction
    stays.

    `step` is called once a tick and costs microseconds.
    """

    estimated_N: float
    """The force as the observer's sense of it is estimated, after the recursive update [N]."""
    perceived: float
    """Mean of the intensity that the commanded force evokes, in units of the reference
    observer's.
    """
    perceived_spread: float
    """Standard deviation of that intensity."""
    steepest: float
    """Greatest slope of command over force: a loop is as stable as on a wall that much stiffer."""
    sentence: str
    """Who feels, and what is done to the force for that; reported before a run."""
    above: bool
    """Whether the last change was above the observer's threshold, and so was rendered."""

    def step(self, force_N: Array) -> Array:
        """Return the force to command [N], shape (3,), for a force at the device [N], shape
        (3,).
        """
        ...

    def pause(self) -> None:
        """Reset after a missing sample: command nothing, and count the next force as a change."""
        ...


class PerceptionMaker(Protocol):
    """Makes a perception on a device."""

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
            What follows the colon of a name such as ``observer:FILE``; empty for one without.
        rng
            Random generator of the noise in the observer's sense.
        force_limit_N, friction_N
            Greatest force and Coulomb friction of the device [N].
        tick_s
            Time between two steps [s].
        """
        ...
