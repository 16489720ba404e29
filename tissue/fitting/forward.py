"""From constants to the loads on a tool: what a kind of scene gives to a fit."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.parameter import Parameter

__all__ = ["Forward", "LinearForward"]


class Forward(Protocol):
    """A scene of which only constants vary: its loads, and their derivatives, along the poses of a log.

    Attributes
    ----------
    parameters
        The free constants, p of them.
    channels
        What is measured, such as ``force_x_N`` and ``torque_z_Nm``: on the tool, in the world frame.
    times_s
        Shape (n,), increasing, on the clock of the poses.
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See the attributes."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """See the attributes."""
        ...

    @property
    def times_s(self) -> Array:
        """See the attributes."""
        ...

    def loads(self, x: Array) -> Array:
        """Loads [N, N m] of the constants x, shape (p,), in their own units: shape (n, channels)."""
        ...

    def jacobian(self, x: Array) -> Array:
        """Derivatives of the loads by the constants, shape (n, channels, p)."""
        ...


@dataclass(frozen=True)
class LinearForward:
    """Loads that are linear in the constants.

    Attributes
    ----------
    parameters, channels, times_s
        See `Forward`.
    basis
        Loads of a unit of each constant, shape (n, channels, p).
    constant
        Loads that no constant changes, shape (n, channels); None for none.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    basis: Array
    constant: Array | None = None

    def loads(self, x: Array) -> Array:
        """See `Forward`."""
        loads = self.basis @ np.asarray(x, dtype=float)
        return loads if self.constant is None else loads + self.constant

    def jacobian(self, x: Array) -> Array:
        """See `Forward`."""
        return self.basis
