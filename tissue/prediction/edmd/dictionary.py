"""Dictionaries of observables.

They are the state alone, delays, polynomials, radial functions, and products with a gap.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = [
    "Delays",
    "Dictionary",
    "GapProducts",
    "Gaussians",
    "Identity",
    "Polynomials",
    "ThinPlates",
]

Indices = NDArray[np.intp]
MEANS_ROUNDS = 25
"""Rounds of Lloyd's algorithm: centres only have to spread over the data, not to converge."""
TINY = 1e-300
"""Smallest squared distance in a logarithm.

The distance times its logarithm vanishes there.
"""


class Dictionary(ABC):
    """Observables φ(x) of a state x.

    The state itself comes first, once, so that the first entries decode it.

    A dictionary with `lags` earlier states takes windows of shape (..., (lags + 1) d), newest state
    first. The leading state is then the whole window, and its newest d entries come first. A
    subclass defines the observables after the state by `extra_size`, `extra` and `extra_rates`. All
    of them work over any leading axes, one sample included.
    """

    lags: int = 0

    @abstractmethod
    def extra_size(self, state_size: int) -> int:
        """Return the number of observables beyond the state."""

    @abstractmethod
    def extra(self, states: Array) -> Array:
        """Return the observables beyond the state, shape (..., extra_size)."""

    @abstractmethod
    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of `extra` for given rates, shape (..., extra_size).

        The rates are the time derivatives of the states.
        """

    def size(self, state_size: int) -> int:
        """Return the number of observables of a state with a given number of entries."""
        return state_size * (self.lags + 1) + self.extra_size(state_size * (self.lags + 1))

    def lift(self, states: Array) -> Array:
        """Return the observables of states or windows, shape (..., D)."""
        return np.concatenate((states, self.extra(states)), axis=-1)

    def lift_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the observables, ∇φ · dx/dt, shape (..., D)."""
        return np.concatenate((rates, self.extra_rates(states, rates)), axis=-1)


@dataclass(frozen=True)
class Identity(Dictionary):
    """The state alone: linear dynamic mode decomposition."""

    def extra_size(self, state_size: int) -> int:
        """Return 0: there are no observables beyond the state."""
        return 0

    def extra(self, states: Array) -> Array:
        """Return an empty array, shape (..., 0)."""
        return states[..., :0]

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return an empty array, shape (..., 0)."""
        return rates[..., :0]


@dataclass(frozen=True)
class Delays(Dictionary):
    """Observables of the present state and the `lags` states before it.

    This is a delay embedding (Takens 1981). The inner dictionary, which has no delays, takes the
    whole window as its state, newest first.
    """

    lags: int
    inner: Dictionary = Identity()

    def extra_size(self, state_size: int) -> int:
        """Return the number of observables that the inner dictionary adds to the window."""
        return self.inner.extra_size(state_size)

    def extra(self, states: Array) -> Array:
        """Return the observables that the inner dictionary adds to the windows."""
        return self.inner.extra(states)

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the inner dictionary's observables."""
        return self.inner.extra_rates(states, rates)


@dataclass(frozen=True)
class Polynomials(Dictionary):
    """All monomials of degree 2 to `order` of the state's entries.

    Degree 1 is the state itself.

    Parameters
    ----------
    order
        Highest degree, 2 or more.
    columns
        Entries of the state (of the window, with delays) to multiply; empty for all.
    """

    order: int
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Return the number of monomials."""
        return sum(
            len(parents) for parents, _ in monomials(len(self.columns) or state_size, self.order)
        )

    def extra(self, states: Array) -> Array:
        """Return the monomials, by degree, then in the order of the entries."""
        levels = [level for level, *_ in self._levels(self._chosen(states))]
        return np.concatenate(levels, axis=-1) if len(levels) > 1 else levels[0]

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the monomials, by the product rule."""
        factors = self._chosen(states)
        slopes = self._chosen(rates)
        slope = slopes
        found = []
        for _, below, parents, entries in self._levels(factors):
            slope = (
                slope[..., parents] * factors[..., entries]
                + below[..., parents] * slopes[..., entries]
            )
            found.append(slope)
        return np.concatenate(found, axis=-1)

    def _levels(self, factors: Array) -> Iterator[tuple[Array, Array, Indices, Indices]]:
        """Yield the monomials of each degree from 2 and the factors they are made of.

        Each item holds the monomials, the monomials of the degree below, and for each monomial the
        index of its factor of the degree below and the index of its entry.
        """
        level = factors
        for parents, entries in monomials(factors.shape[-1], self.order):
            below = level
            level = level[..., parents] * factors[..., entries]
            yield level, below, parents, entries

    def _chosen(self, states: Array) -> Array:
        return states[..., self._columns] if self.columns else states

    @cached_property
    def _columns(self) -> Indices:
        return np.array(self.columns, dtype=np.intp)


@lru_cache(maxsize=64)
def monomials(entry_count: int, order: int) -> tuple[tuple[Indices, Indices], ...]:
    """Return, for each degree from 2, the two factors of each monomial.

    The first factor is the index of a monomial of the degree below, the second the index of an
    entry.
    """
    last = list(range(entry_count))
    levels = []
    for _ in range(2, order + 1):
        made = [
            (parent, entry)
            for parent, highest in enumerate(last)
            for entry in range(highest, entry_count)
        ]
        last = [entry for _, entry in made]
        levels.append(
            (np.array([p for p, _ in made], np.intp), np.array([e for _, e in made], np.intp))
        )
    return tuple(levels)


@dataclass(frozen=True)
class _Radial(Dictionary):
    """Observables of the scaled distance between the state's entries and each centre.

    Parameters
    ----------
    centres
        Rows of k centres, shape (k, c), in the units of the state.
    scales
        Unit of distance for each of the c entries, in the entry's unit; empty for 1.
    columns
        Entries of the state (of the window, with delays) that are used; empty for all.
    """

    centres: tuple[tuple[float, ...], ...]
    scales: tuple[float, ...] = ()
    columns: tuple[int, ...] = ()

    @classmethod
    def from_states(
        cls,
        states: Array,
        count: int,
        rng: np.random.Generator,
        *,
        columns: Sequence[int] = (),
        **options: float,
    ) -> Self:
        """Return a dictionary whose centres are spread over recorded states (rows) by k-means.

        Distances are measured in standard deviations of the states.

        Raises
        ------
        InputError
            If a column is constant, or there are fewer different states than centres.
        """
        from scipy.cluster.vq import kmeans2

        chosen = states[:, list(columns)] if columns else states
        scales = chosen.std(axis=0)
        if not (scales > 0.0).all():
            raise InputError(
                f"column {int(np.argmin(scales))} of states",
                "vary",
                f"{chosen[0, np.argmin(scales)]:g} throughout",
                "leave it out",
            )
        rows = np.unique(chosen / scales, axis=0)
        if len(rows) < count:
            raise InputError(
                "count",
                f"be in [1, {len(rows)}], the number of different states",
                count,
                "record more",
            )
        # Initial centres by k-means++ (Arthur & Vassilvitskii 2007).
        centres, _ = kmeans2(rows, count, iter=MEANS_ROUNDS, minit="++", rng=rng)
        placed = tuple(map(tuple, (centres * scales).tolist()))
        return cls(centres=placed, scales=tuple(scales.tolist()), columns=tuple(columns), **options)

    def extra_size(self, state_size: int) -> int:
        """Return the number of centres."""
        return len(self.centres)

    def _offsets(self, states: Array) -> Array:
        """Return the scaled vectors from the centres to the states, shape (..., k, c)."""
        return (self._chosen(states)[..., None, :] - self._centres) * self._per_length

    def _square_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of half the squared distances, shape (..., k)."""
        return (self._offsets(states) * (self._chosen(rates)[..., None, :] * self._per_length)).sum(
            axis=-1
        )

    def _chosen(self, states: Array) -> Array:
        return states[..., list(self.columns)] if self.columns else states

    @cached_property
    def _centres(self) -> Array:
        return np.array(self.centres)

    @cached_property
    def _per_length(self) -> Array:
        return 1.0 / np.array(self.scales or 1.0)


@dataclass(frozen=True)
class Gaussians(_Radial):
    """Gaussians exp(-r² / (2 width²)) of the scaled distance r to each centre.

    See `_Radial` for the other parameters.
    """

    width: float = 1.0

    def extra(self, states: Array) -> Array:
        """Return the Gaussians, shape (..., k)."""
        return np.exp((self._offsets(states) ** 2).sum(axis=-1) / (-2.0 * self.width**2))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the Gaussians, shape (..., k)."""
        return self.extra(states) * self._square_rates(states, rates) / -(self.width**2)


@dataclass(frozen=True)
class ThinPlates(_Radial):
    """Thin-plate splines r² ln r of the scaled distance r to each centre (Duchon 1977).

    They grow outside the data, where Gaussians vanish.
    """

    def extra(self, states: Array) -> Array:
        """Return the thin-plate splines, shape (..., k)."""
        squares = (self._offsets(states) ** 2).sum(axis=-1)
        return 0.5 * squares * np.log(np.maximum(squares, TINY))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the thin-plate splines, shape (..., k)."""
        squares = (self._offsets(states) ** 2).sum(axis=-1)
        return (np.log(np.maximum(squares, TINY)) + 1.0) * self._square_rates(states, rates)


@dataclass(frozen=True)
class GapProducts(Dictionary):
    """Observables of unilateral contact with a gap g and an overlap p = max(0, -g).

    The gap is g = normal · x + distance. The observables are p and p², and for each entry x_j of
    `columns` the product p x_j and the entry x_j while the gap is closed. With the velocity among
    the columns, the force of a unilateral spring and damper is a combination of p and the velocity.

    Parameters
    ----------
    normal
        Weights of the state's first entries in the gap, each in the gap's unit over the entry's.
    distance
        Gap at the state zero, in the gap's unit.
    columns
        Entries of the state to multiply. Leave out the gap's own entry, which would repeat the
        overlap.
    """

    normal: tuple[float, ...]
    distance: float = 0.0
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Return the number of observables: two, and two for each column."""
        return 2 + 2 * len(self.columns)

    def extra(self, states: Array) -> Array:
        """Return the overlap, its products, and the entries while closed.

        The shape is (..., 2 + 2 columns).
        """
        overlap = np.maximum(0.0, -self._gap(states))[..., None]
        entries = states[..., self._columns]
        return np.concatenate(
            (overlap, overlap**2, overlap * entries, (overlap > 0.0) * entries), axis=-1
        )

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Return the time derivatives of the observables.

        At the switch of the contact they do not exist.
        """
        gap = self._gap(states)
        closed = (gap < 0.0)[..., None]
        overlap = np.maximum(0.0, -gap)[..., None]
        closing = (
            np.where(closed, -1.0, 0.0) * (rates[..., : len(self.normal)] @ self._normal)[..., None]
        )
        entries = states[..., self._columns]
        slopes = rates[..., self._columns]
        squared = 2.0 * overlap * closing
        products = closing * entries + overlap * slopes
        return np.concatenate((closing, squared, products, closed * slopes), axis=-1)

    def _gap(self, states: Array) -> Array:
        return states[..., : len(self.normal)] @ self._normal + self.distance

    @cached_property
    def _normal(self) -> Array:
        return np.array(self.normal)

    @cached_property
    def _columns(self) -> NDArray[np.intp]:
        return np.array(self.columns, dtype=np.intp)
