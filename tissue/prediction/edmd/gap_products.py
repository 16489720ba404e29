"""Observables that switch where a gap closes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.prediction.edmd.dictionary import Dictionary

__all__ = ["GapProducts"]


@dataclass(frozen=True)
class GapProducts(Dictionary):
    """What contact adds to a state, with the gap g = normal · x + distance and the overlap p = max(0, -g).

    The overlap p and its square; for each of `columns` the product p x_j, and x_j while the gap is closed. With the
    velocity among the columns the force of a unilateral spring and damper is a combination of p and of that velocity.

    Parameters
    ----------
    normal
        Weights of the state's first entries in the gap, each in the gap's unit over the entry's.
    distance
        Gap at the state zero, in the gap's unit.
    columns
        Entries of the state to multiply, the gap's own entry not among them: that would repeat the overlap.
    """

    normal: tuple[float, ...]
    distance: float = 0.0
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Two, and two for each column."""
        return 2 + 2 * len(self.columns)

    def extra(self, states: Array) -> Array:
        """The overlap, its products, and the entries while closed, shape (..., 2 + 2 columns)."""
        overlap = np.maximum(0.0, -self._gap(states))[..., None]
        entries = states[..., self._columns]
        return np.concatenate((overlap, overlap**2, overlap * entries, (overlap > 0.0) * entries), axis=-1)

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives away from the switch, where they have none."""
        gap = self._gap(states)
        closed = (gap < 0.0)[..., None]
        overlap = np.maximum(0.0, -gap)[..., None]
        closing = np.where(closed, -1.0, 0.0) * (rates[..., : len(self.normal)] @ self._normal)[..., None]
        entries, slopes = states[..., self._columns], rates[..., self._columns]
        squared, products = 2.0 * overlap * closing, closing * entries + overlap * slopes
        return np.concatenate((closing, squared, products, closed * slopes), axis=-1)

    def _gap(self, states: Array) -> Array:
        return states[..., : len(self.normal)] @ self._normal + self.distance

    @cached_property
    def _normal(self) -> Array:
        return np.array(self.normal)

    @cached_property
    def _columns(self) -> NDArray[np.intp]:
        return np.array(self.columns, dtype=np.intp)
