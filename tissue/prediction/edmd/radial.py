"""Observables that depend on the distance to centres: Gaussians and thin plates."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from scipy.cluster.vq import kmeans2

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Dictionary

__all__ = ["Gaussians", "ThinPlates"]

MEANS_ROUNDS = 25
"""Rounds of Lloyd's algorithm: centres only have to spread over the data, not to converge."""
TINY = 1e-300
"""Smallest squared distance that a logarithm is taken of; times it, the logarithm vanishes."""


@dataclass(frozen=True)
class _Radial(Dictionary):
    """Observables of the scaled distance between the state's entries and each centre.

    Parameters
    ----------
    centres
        Rows of k centres, shape (k, c), in the units of the state.
    scales
        One length for each of the c entries, in its unit: distances are measured in these; empty for 1.
    columns
        Entries of the state (of the window, with delays) that are looked at; empty for all.
    """

    centres: tuple[tuple[float, ...], ...]
    scales: tuple[float, ...] = ()
    columns: tuple[int, ...] = ()

    @classmethod
    def from_states(
        cls, states: Array, count: int, rng: np.random.Generator, *, columns: Sequence[int] = (), **options: float
    ) -> Self:
        """Centres spread over recorded states (rows) by k-means, distances measured in their standard deviations.

        Raises
        ------
        InputError
            If a column is constant, or there are fewer different states than centres.
        """
        chosen = states[:, list(columns)] if columns else states
        scales = chosen.std(axis=0)
        if not (scales > 0.0).all():
            raise InputError(
                f"column {int(np.argmin(scales))} of states must vary, got {chosen[0, np.argmin(scales)]:g} "
                "throughout: leave it out"
            )
        rows = np.unique(chosen / scales, axis=0)
        if len(rows) < count:
            raise InputError(
                f"count must be in [1, {len(rows)}], the number of different states, got {count}: record more"
            )
        # Seeded by k-means++ (Arthur & Vassilvitskii 2007).
        centres, _ = kmeans2(rows, count, iter=MEANS_ROUNDS, minit="++", rng=rng)
        placed = tuple(map(tuple, (centres * scales).tolist()))
        return cls(centres=placed, scales=tuple(scales.tolist()), columns=tuple(columns), **options)

    def extra_size(self, state_size: int) -> int:
        """Number of centres."""
        return len(self.centres)

    def _offsets(self, states: Array) -> Array:
        """From the centres to the states, scaled, shape (..., k, c)."""
        return (self._chosen(states)[..., None, :] - self._centres) * self._per_length

    def _square_rates(self, states: Array, rates: Array) -> Array:
        """Time derivatives of half the squared distances, shape (..., k)."""
        return (self._offsets(states) * (self._chosen(rates)[..., None, :] * self._per_length)).sum(axis=-1)

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
    """exp(-r² / (2 width²)) of the scaled distance r to each centre; see `_Radial` for the other parameters."""

    width: float = 1.0

    def extra(self, states: Array) -> Array:
        """The Gaussians, shape (..., k)."""
        return np.exp((self._offsets(states) ** 2).sum(axis=-1) / (-2.0 * self.width**2))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, shape (..., k)."""
        return self.extra(states) * self._square_rates(states, rates) / -(self.width**2)


@dataclass(frozen=True)
class ThinPlates(_Radial):
    """r² ln r of the scaled distance r to each centre (Duchon 1977); it grows outside the data, where Gaussians end."""

    def extra(self, states: Array) -> Array:
        """The thin plates, shape (..., k)."""
        squares = (self._offsets(states) ** 2).sum(axis=-1)
        return 0.5 * squares * np.log(np.maximum(squares, TINY))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, shape (..., k)."""
        squares = (self._offsets(states) ** 2).sum(axis=-1)
        return (np.log(np.maximum(squares, TINY)) + 1.0) * self._square_rates(states, rates)
