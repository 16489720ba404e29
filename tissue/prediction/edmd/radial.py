"""Observables that depend on the distance to centres: Gaussians and thin plates."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.prediction.edmd.dictionary import Dictionary, require_columns

__all__ = ["Gaussians", "ThinPlates", "spread_centres"]

MEANS_ROUNDS = 25
"""Rounds of Lloyd's algorithm: centres only have to spread over the data, not to converge."""
MEANS_ROWS = 5000
"""Rows that are looked at for centres, drawn from all."""
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

    Raises
    ------
    InputError
        If there is no centre, one is not finite, or a scale is not positive.
    """

    centres: tuple[tuple[float, ...], ...]
    scales: tuple[float, ...] = ()
    columns: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        centres = np.array(self.centres, dtype=np.float64)
        if centres.ndim != 2 or not len(centres) or not np.isfinite(centres).all():
            raise InputError(f"centres must be a finite table with a row for each, got shape {centres.shape}: give one")
        if self.scales and not (len(self.scales) == centres.shape[1] and all(0.0 < s < np.inf for s in self.scales)):
            raise InputError(f"scales must be {centres.shape[1]} positive numbers, got {self.scales}: use deviations")
        if self.columns and len(self.columns) != centres.shape[1]:
            raise InputError(
                f"columns must be {centres.shape[1]} for these centres, got {len(self.columns)}: name each"
            )

    @classmethod
    def from_states(
        cls, states: Array, count: int, rng: np.random.Generator, *, columns: Sequence[int] = (), **options: float
    ) -> Self:
        """Centres spread over recorded states (rows), distances measured in their standard deviations."""
        chosen = np.asarray(states, dtype=np.float64)[:, list(columns)] if len(columns) else np.asarray(states, float)
        scales = chosen.std(axis=0)
        if not (scales > 0.0).all():
            raise InputError(
                f"column {int(np.argmin(scales))} of states must vary, got {chosen[0, np.argmin(scales)]:g} "
                "throughout: leave it out"
            )
        centres = spread_centres(chosen / scales, count, rng) * scales
        return cls(
            centres=tuple(tuple(map(float, row)) for row in centres),
            scales=tuple(map(float, scales)),
            columns=tuple(int(column) for column in columns),
            **options,
        )

    def extra_size(self, state_size: int) -> int:
        """Number of centres."""
        require_columns(self.columns, state_size)
        if not self.columns and len(self.centres[0]) != state_size:
            raise InputError(
                f"centres must have {state_size} columns as the state has, got {len(self.centres[0])}: name the columns"
            )
        return len(self.centres)

    def _squares(self, states: Array) -> Array:
        """Squared scaled distances to the centres, shape (..., k)."""
        near = self._scaled(states) - self._middle
        squares = (near * near).sum(axis=-1, keepdims=True) - 2.0 * (near @ self._from_middle) + self._squared_norms
        return np.maximum(squares, 0.0, out=squares)

    def _square_rates(self, states: Array, rates: Array) -> Array:
        """Time derivatives of half the squared distances, shape (..., k)."""
        near = self._scaled(states) - self._middle
        slopes = self._scaled(rates)
        return (near * slopes).sum(axis=-1, keepdims=True) - slopes @ self._from_middle

    def _scaled(self, states: Array) -> Array:
        chosen = states[..., self._chosen] if self.columns else states
        return chosen / self._scales if self.scales else chosen

    @cached_property
    def _chosen(self) -> NDArray[np.intp]:
        return np.array(self.columns, dtype=np.intp)

    @cached_property
    def _scales(self) -> Array:
        return np.array(self.scales)

    @cached_property
    def _scaled_centres(self) -> Array:
        centres = np.array(self.centres, dtype=np.float64)
        return centres / self._scales if self.scales else centres

    @cached_property
    def _middle(self) -> Array:
        """Squares are taken about it, so that large offsets do not cost digits."""
        return self._scaled_centres.mean(axis=0)

    @cached_property
    def _from_middle(self) -> Array:
        return np.ascontiguousarray((self._scaled_centres - self._middle).T)

    @cached_property
    def _squared_norms(self) -> Array:
        return (self._from_middle**2).sum(axis=0)


@dataclass(frozen=True)
class Gaussians(_Radial):
    """exp(-r² / (2 width²)) of the scaled distance r to each centre; see `_Radial` for the other parameters."""

    width: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive("width", self.width, "use 1, the distance being in standard deviations")

    def extra(self, states: Array) -> Array:
        """The Gaussians, shape (..., k)."""
        return np.exp(self._squares(states) / (-2.0 * self.width**2))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, shape (..., k)."""
        return self.extra(states) * self._square_rates(states, rates) / -(self.width**2)


@dataclass(frozen=True)
class ThinPlates(_Radial):
    """r² ln r of the scaled distance r to each centre (Duchon 1977); it grows outside the data, where Gaussians end."""

    def extra(self, states: Array) -> Array:
        """The thin plates, shape (..., k)."""
        squares = self._squares(states)
        return 0.5 * squares * np.log(np.maximum(squares, TINY))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Their time derivatives, shape (..., k)."""
        logarithms = np.log(np.maximum(self._squares(states), TINY)) + 1.0
        return logarithms * self._square_rates(states, rates)


def spread_centres(rows: Array, count: int, rng: np.random.Generator) -> Array:
    """Centres that spread over the rows: k-means with k-means++ seeding (Arthur & Vassilvitskii 2007), shape (k, c).

    Raises
    ------
    InputError
        If there are fewer different rows than centres.
    """
    rows = np.unique(rows, axis=0)
    if not 1 <= count <= len(rows):
        raise InputError(f"count must be in [1, {len(rows)}], the number of different states, got {count}: record more")
    rows = (
        rows[np.sort(rng.choice(len(rows), MEANS_ROWS, replace=False))] if len(rows) > max(MEANS_ROWS, count) else rows
    )
    centres = np.empty((count, rows.shape[1]))
    far = np.full(len(rows), np.inf)
    for index in range(count):
        # A row that is a centre already has weight zero.
        centres[index] = rows[rng.integers(len(rows)) if index == 0 else rng.choice(len(rows), p=far / far.sum())]
        far = np.minimum(far, ((rows - centres[index]) ** 2).sum(axis=1))
    for _ in range(MEANS_ROUNDS):
        squares = (centres**2).sum(axis=1) - 2.0 * rows @ centres.T
        nearest = squares.argmin(axis=1)
        members = np.bincount(nearest, minlength=count)
        sums = np.stack([np.bincount(nearest, column, count) for column in rows.T], axis=1)
        centres = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], centres)
    return centres
