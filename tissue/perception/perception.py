"""What a loop asks of a model of the person who feels."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Perception"]

Array = NDArray[np.float64]


class Perception(Protocol):
    """Turns a force that shall be felt into the force to command, for one observer; direction stays.

    `step` is called once a tick and costs microseconds.
    """

    estimated_N: float
    """The force as the observer's sense of it is estimated, after the recursive update [N]."""
    perceived: float
    """Mean of the intensity that the commanded force evokes, in units of the reference observer's."""
    perceived_spread: float
    """Standard deviation of that intensity."""
    above: bool
    """Whether the last change was above the observer's threshold, and so was rendered."""

    def step(self, force_N: Array) -> Array:
        """Force to command [N], shape (3,), for a force at the device [N], shape (3,)."""
        ...

    def pause(self) -> None:
        """No sample came: nothing is commanded, and the next force counts as a change."""
        ...
