"""Interface of a force predictor in a loop, and the zero-order hold."""

from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array

__all__ = [
    "CONTACT_WIDTH",
    "Contact",
    "Hold",
    "Predictor",
    "SeesContact",
]


class Predictor(Protocol):
    """Predictor of the force on a device some ticks ahead of the last observation.

    Once a tick `observe` receives the device position and velocity and, in ticks with a tissue
    answer, the force. Then `predict` returns the expected force. Both have a fixed cost.
    """

    residual_N: float
    """Size of the last one-tick error [N]: expected minus measured newest force."""
    is_primary: bool
    """True if the last predicted force is the predictor's own, not its fallback's."""

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the device's position [m] and velocity [m/s], shape (3,), and the force [N].

        The force acts on the device. It is None in a tick without a force.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Predict the force a number of ticks after the last observation [N], shape (3,).

        Zero ticks give the present force. The number of ticks need not be whole, because the delay
        of a force on its path to the motor is not, see `tissue.haptics.loop.sampled_loop`.
        """
        ...

    def pause(self) -> None:
        """Pause after a missing sample: the next sample does not follow the last."""
        ...


class Hold:
    """Zero-order hold: the baseline that keeps the last force."""

    residual_N = 0.0
    is_primary = True

    def __init__(self) -> None:
        self._force = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Store the force."""
        if force_N is not None:
            change = force_N - self._force
            self.residual_N = float(np.sqrt(change @ change))
            self._force = force_N.copy()

    def predict(self, ticks: float) -> Array:
        """Return the last force."""
        return self._force

    def pause(self) -> None:
        """Do nothing: the hold does not depend on the ticks between forces."""


CONTACT_WIDTH = 21
"""Number of values of a contact in a recording."""


@dataclass
class Contact:
    """A tool coupled to a device by a spring, and the local law of the tissue.

    All values are in metres and newtons at the device.

    Attributes
    ----------
    spring_N_m
        Stiffness of the coupling.
    tip_m
        Position of the tool [m], shape (3,). Where no force acts on the tool, it is at the device.
    force_N
        Force of the tissue on the tool there, shape (3,).
    stiffness_N_m
        Decrease of that force with the tool's position, -dF/dx [N/m], shape (3, 3); None where the
        tissue does not provide it.
    gap_m, normal
        Distance of a free tool from the tissue's surface [m], infinite where the tissue does not
        provide it, and the unit direction out of the surface, shape (3,).
    cuts
        True if the tool cuts. Then no force pushes it back to its earlier position.
    """

    spring_N_m: float
    tip_m: Array
    force_N: Array
    stiffness_N_m: Array | None = None
    gap_m: float = inf
    normal: Array = field(default_factory=lambda: np.zeros(3))
    cuts: bool = False

    def row(self) -> Array:
        """Return all values as one row, shape (CONTACT_WIDTH,); NaN for an unknown stiffness."""
        stiffness = np.full(9, nan) if self.stiffness_N_m is None else self.stiffness_N_m.ravel()
        return np.concatenate(
            (
                (self.spring_N_m,),
                self.tip_m,
                self.force_N,
                stiffness,
                (self.gap_m,),
                self.normal,
                (self.cuts,),
            )
        )

    @classmethod
    def of_row(cls, row: Array) -> "Contact":
        """Return the contact of a row made by `row`."""
        stiffness = None if isnan(row[7]) else row[7:16].reshape(3, 3)
        return cls(
            float(row[0]), row[1:4], row[4:7], stiffness, float(row[16]), row[17:20], bool(row[20])
        )


@runtime_checkable
class SeesContact(Protocol):
    """Predictor that receives the contact of a tick before it observes the tick."""

    def meet(self, contact: Contact) -> None:
        """Store the contact of the next observation, not by reference."""
        ...
