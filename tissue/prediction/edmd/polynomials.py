"""Products of state entries up to an order."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Dictionary, require_columns

__all__ = ["Polynomials"]

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Polynomials(Dictionary):
    """All monomials of degree 2 to `order` of the state's entries; degree 1 is the state itself.

    With `middle` and `scales` they are monomials of (x - middle) / scales, which keeps higher orders well conditioned
    where a state varies little about a large value.

    Parameters
    ----------
    order
        Highest degree, at least 2.
    columns
        Entries of the state (of the window, with delays) to multiply; empty for all.
    middle, scales
        One number for each of those entries, in its unit; empty for 0 and 1.

    Raises
    ------
    InputError
        If the order is below 2 or a scale is not positive.
    """

    order: int
    columns: tuple[int, ...] = ()
    middle: tuple[float, ...] = ()
    scales: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.order < 2 or self.order != int(self.order):
            raise InputError(f"order must be a whole number of at least 2, got {self.order}: use 2, or Identity()")
        if not all(scale > 0.0 for scale in self.scales):
            raise InputError(f"scales must be positive, got {min(self.scales)}: use standard deviations")

    def extra_size(self, state_size: int) -> int:
        """Number of monomials."""
        require_columns(self.columns, state_size)
        count = len(self.columns) or state_size
        for name in ("middle", "scales"):
            given = len(getattr(self, name))
            if given not in (0, count):
                raise InputError(
                    f"{name} must be one number for each of {count} entries, got {given}: name the columns"
                )
        return sum(len(parents) for parents, _ in monomials(count, self.order))

    def extra(self, states: Array) -> Array:
        """The monomials, by degree, then in the order of the entries."""
        factors = self._factors(states)
        level, levels = factors, []
        for parents, entries in monomials(factors.shape[-1], self.order):
            level = level[..., parents] * factors[..., entries]
            levels.append(level)
        return np.concatenate(levels, axis=-1) if len(levels) > 1 else level

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, by the product rule."""
        factors = self._factors(states)
        slopes = rates[..., self._columns] if self.columns else rates
        slopes = slopes / self._scales if self.scales else slopes
        level, slope, found = factors, slopes, []
        for parents, entries in monomials(factors.shape[-1], self.order):
            slope = slope[..., parents] * factors[..., entries] + level[..., parents] * slopes[..., entries]
            level = level[..., parents] * factors[..., entries]
            found.append(slope)
        return np.concatenate(found, axis=-1)

    def _factors(self, states: Array) -> Array:
        """The entries that are multiplied."""
        factors = states[..., self._columns] if self.columns else states
        factors = factors - self._middle if self.middle else factors
        return factors / self._scales if self.scales else factors

    @cached_property
    def _columns(self) -> Indices:
        return np.array(self.columns, dtype=np.intp)

    @cached_property
    def _middle(self) -> Array:
        return np.array(self.middle)

    @cached_property
    def _scales(self) -> Array:
        return np.array(self.scales)


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
