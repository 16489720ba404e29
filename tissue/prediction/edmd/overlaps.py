"""Observables for the depth of a contact, now and some steps ahead."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array
from tissue.prediction.edmd.dictionary import Dictionary

__all__ = ["Overlaps"]


@dataclass(frozen=True)
class Overlaps(Dictionary):
    """max(0, -g) of the gap g = normal · x + distance that a steady speed leads to after each of `leads` steps.

    The speed is the path of the last `span` steps over these, long enough to see past the steps of an encoder. A
    unilateral spring met at a steady speed is linear in these observables before it is touched, which no combination
    of earlier positions and forces is. One product with a matrix gives all of them.

    Parameters
    ----------
    normal
        Weights of the state's first entries in the gap, in the gap's unit over theirs.
    distance
        Gap at the state zero.
    leads
        Steps ahead.
    span, width
        Steps over which the speed is taken, at most the delays; entries of a state without its delays.
    """

    normal: tuple[float, ...]
    distance: float
    leads: tuple[float, ...]
    span: int
    width: int

    def extra_size(self, state_size: int) -> int:
        """Number of leads."""
        return len(self.leads)

    def extra(self, states: Array) -> Array:
        """The overlaps, shape (..., leads)."""
        return np.maximum(0.0, -self.gaps(states))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives; at the switch, that of the open gap."""
        return np.where(self.gaps(states) < 0.0, -(rates[..., : len(self._weights)] @ self._weights), 0.0)

    def gaps(self, states: Array) -> Array:
        """The gap after each lead, shape (..., leads)."""
        return np.asarray(states[..., : len(self._weights)] @ self._weights + self.distance)

    @cached_property
    def _weights(self) -> Array:
        """Gap over window, shape ((span + 1) width, leads)."""
        weights = np.zeros(((self.span + 1) * self.width, len(self.leads)))
        share = np.array(self.leads) / self.span
        for entry, weight in enumerate(self.normal):
            weights[entry] = weight * (1.0 + share)
            weights[self.span * self.width + entry] = -weight * share
        return weights
