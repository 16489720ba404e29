"""Products of state entries up to an order."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.prediction.edmd.dictionary import Dictionary

__all__ = ["Polynomials"]

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Polynomials(Dictionary):
    """All monomials of degree 2 to `order` of the state's entries; degree 1 is the state itself.

    Parameters
    ----------
    order
        Highest degree, at least 2.
    columns
        Entries of the state (of the window, with delays) to multiply; empty for all.
    """

    order: int
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Number of monomials."""
        return sum(len(parents) for parents, _ in monomials(len(self.columns) or state_size, self.order))

    def extra(self, states: Array) -> Array:
        """The monomials, by degree, then in the order of the entries."""
        levels = [level for level, *_ in self._levels(self._chosen(states))]
        return np.concatenate(levels, axis=-1) if len(levels) > 1 else levels[0]

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, by the product rule."""
        factors, slopes = self._chosen(states), self._chosen(rates)
        slope, found = slopes, []
        for _, below, parents, entries in self._levels(factors):
            slope = slope[..., parents] * factors[..., entries] + below[..., parents] * slopes[..., entries]
            found.append(slope)
        return np.concatenate(found, axis=-1)

    def _levels(self, factors: Array) -> Iterator[tuple[Array, Array, Indices, Indices]]:
        """Monomials of each degree from 2, those of the degree below, and which of these times which entry they are."""
        level = factors
        for parents, entries in monomials(factors.shape[-1], self.order):
            below, level = level, level[..., parents] * factors[..., entries]
            yield level, below, parents, entries

    def _chosen(self, states: Array) -> Array:
        return states[..., self._columns] if self.columns else states

    @cached_property
    def _columns(self) -> Indices:
        return np.array(self.columns, dtype=np.intp)


@lru_cache(maxsize=64)
def monomials(entry_count: int, order: int) -> tuple[tuple[Indices, Indices], ...]:
    """For each degree from 2, which monomial of the degree below and which entry make each monomial."""
    last = list(range(entry_count))
    levels = []
    for _ in range(2, order + 1):
        made = [(parent, entry) for parent, highest in enumerate(last) for entry in range(highest, entry_count)]
        last = [entry for _, entry in made]
        levels.append((np.array([p for p, _ in made], np.intp), np.array([e for _, e in made], np.intp)))
    return tuple(levels)
