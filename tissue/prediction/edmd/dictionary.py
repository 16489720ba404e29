"""Observables of a state: the contract of a dictionary, the state alone, sums of dictionaries, and delays."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["Delays", "Dictionary", "DictionarySum", "Identity", "require_columns"]


class Dictionary(ABC):
    """Observables φ(x) of a state x. The state itself leads them, once, so that its first entries decode it.

    A dictionary with `lags` earlier states in it takes windows of shape (..., (lags + 1) d), newest state first; the
    state that leads is then the whole window, and its newest d entries come first. A further dictionary states what
    follows the state: `extra_size`, `extra` and `extra_rates`; all work over any leading axes, one sample included.
    """

    lags: int = 0

    @abstractmethod
    def extra_size(self, state_size: int) -> int:
        """Number of observables beyond the state."""

    @abstractmethod
    def extra(self, states: Array) -> Array:
        """Observables beyond the state, shape (..., extra_size)."""

    @abstractmethod
    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Time derivatives of `extra` where the states change with these rates, shape (..., extra_size)."""

    def size(self, state_size: int) -> int:
        """Number of observables of a state of so many entries."""
        return state_size * (self.lags + 1) + self.extra_size(state_size * (self.lags + 1))

    def lift(self, states: Array) -> Array:
        """Observables of states or windows, shape (..., D)."""
        return np.concatenate((states, self.extra(states)), axis=-1)

    def lift_rates(self, states: Array, rates: Array) -> Array:
        """Time derivatives of the observables, ∇φ · dx/dt, shape (..., D)."""
        return np.concatenate((rates, self.extra_rates(states, rates)), axis=-1)

    def __add__(self, other: "Dictionary") -> "DictionarySum":
        """The observables of both; the state leads once."""
        parts = [*(self.parts if isinstance(self, DictionarySum) else (self,))]
        parts += other.parts if isinstance(other, DictionarySum) else (other,)
        return DictionarySum(tuple(parts))


@dataclass(frozen=True)
class Identity(Dictionary):
    """The state and nothing else: linear dynamic mode decomposition."""

    def extra_size(self, state_size: int) -> int:
        """None."""
        return 0

    def extra(self, states: Array) -> Array:
        """None, shape (..., 0)."""
        return np.zeros((*states.shape[:-1], 0))

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """None, shape (..., 0)."""
        return np.zeros((*states.shape[:-1], 0))

    def lift(self, states: Array) -> Array:
        """The states."""
        return states


@dataclass(frozen=True)
class DictionarySum(Dictionary):
    """The state, then what each part adds to it, in order.

    Raises
    ------
    InputError
        If a part has delays: `Delays` goes around the sum, not into it.
    """

    parts: tuple[Dictionary, ...]

    def __post_init__(self) -> None:
        delayed = [part for part in self.parts if part.lags]
        if delayed:
            raise InputError(f"parts must have no delays, got {delayed[0].lags} lags: put Delays around the sum")

    def extra_size(self, state_size: int) -> int:
        """Sum over the parts."""
        return sum(part.extra_size(state_size) for part in self.parts)

    def extra(self, states: Array) -> Array:
        """What the parts add, one after the other."""
        return np.concatenate([part.extra(states) for part in self.parts], axis=-1)

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Its time derivatives."""
        return np.concatenate([part.extra_rates(states, rates) for part in self.parts], axis=-1)


@dataclass(frozen=True)
class Delays(Dictionary):
    """Observables of the present state and the `lags` states before it: a delay embedding (Takens 1981).

    The inner dictionary takes the whole window for its state, newest first.

    Raises
    ------
    InputError
        If lags is negative or the inner dictionary has delays of its own.
    """

    lags: int
    inner: Dictionary = Identity()

    def __post_init__(self) -> None:
        if self.lags < 0 or self.lags != int(self.lags):
            raise InputError(f"lags must be a whole number of at least 0, got {self.lags}: use 3")
        if self.inner.lags:
            raise InputError(f"inner must have no delays, got {self.inner.lags} lags: add them to the outer lags")

    def extra_size(self, state_size: int) -> int:
        """What the inner dictionary adds to the window."""
        return self.inner.extra_size(state_size)

    def extra(self, states: Array) -> Array:
        """What the inner dictionary adds to the windows."""
        return self.inner.extra(states)

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Its time derivatives."""
        return self.inner.extra_rates(states, rates)


def require_columns(columns: Sequence[int], state_size: int) -> None:
    """Refuse columns that a state, or with delays a window, does not have.

    Raises
    ------
    InputError
        Names the first of them and how many there are.
    """
    for column in columns:
        if not 0 <= column < state_size:
            raise InputError(
                f"columns must be in [0, {state_size - 1}], got {column}: the state has {state_size} entries"
            )
