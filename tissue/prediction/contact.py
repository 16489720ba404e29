"""What a loop knows of its tool's contact in a tick, for predictors that ask the tissue's own
law.
"""

from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array

__all__ = ["CONTACT_WIDTH", "Contact", "SeesContact"]

CONTACT_WIDTH = 21
"""Numbers of a contact in a recording."""


@dataclass
class Contact:
    """A tool that hangs on a device by a spring, and the tissue's local law, in metres and newtons
    at the device.

    Attributes
    ----------
    spring_N_m
        Stiffness of the coupling.
    tip_m
        Where the tool is [m], shape (3,); where nothing acts on it, the device is there, too.
    force_N
        Force of the tissue on the tool there, shape (3,).
    stiffness_N_m
        How that force falls with the tool's position, -dF/dx [N/m], shape (3, 3); None where the
        tissue does not know it.
    gap_m, normal
        Distance of a free tool from the tissue's surface [m], and the unit direction out of it,
        shape (3,); infinite where the tissue does not know it.
    cuts
        Whether the tool cuts, so that nothing pushes it back to where it was.
    """

    spring_N_m: float
    tip_m: Array
    force_N: Array
    stiffness_N_m: Array | None = None
    gap_m: float = inf
    normal: Array = field(default_factory=lambda: np.zeros(3))
    cuts: bool = False

    def row(self) -> Array:
        """All of it as numbers, shape (CONTACT_WIDTH,); NaN for a stiffness that is not known."""
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
        """The contact that `row` was made of."""
        stiffness = None if isnan(row[7]) else row[7:16].reshape(3, 3)
        return cls(
            float(row[0]), row[1:4], row[4:7], stiffness, float(row[16]), row[17:20], bool(row[20])
        )


@runtime_checkable
class SeesContact(Protocol):
    """A predictor that is shown the contact of a tick before it observes the tick."""

    def meet(self, contact: Contact) -> None:
        """Take in the contact; it belongs to the next observation, and is not kept by reference."""
        ...
