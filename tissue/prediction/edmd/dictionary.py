"""Observables of a state: the contract of a dictionary, the state alone, and delays."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array

__all__ = ["Delays", "Dictionary", "Identity"]


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


@dataclass(frozen=True)
class Identity(Dictionary):
    """The state and nothing else: linear dynamic mode decomposition."""

    def extra_size(self, state_size: int) -> int:
        """None."""
        return 0

    def extra(self, states: Array) -> Array:
        """None, shape (..., 0)."""
        return states[..., :0]

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """None, shape (..., 0)."""
        return rates[..., :0]


@dataclass(frozen=True)
class Delays(Dictionary):
    """Observables of the present state and the `lags` states before it: a delay embedding (Takens 1981).

    The inner dictionary, which has no delays, takes the whole window for its state, newest first.
    """

    lags: int
    inner: Dictionary = Identity()

    def extra_size(self, state_size: int) -> int:
        """What the inner dictionary adds to the window."""
        return self.inner.extra_size(state_size)

    def extra(self, states: Array) -> Array:
        """What the inner dictionary adds to the windows."""
        return self.inner.extra(states)

    def extra_rates(self, states: Array, rates: Array) -> Array:
        """Its time derivatives."""
        return self.inner.extra_rates(states, rates)
