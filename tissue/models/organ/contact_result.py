"""What a contact does to tool and organ, and how its solve ended."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from meshes.base.arrays import Array

__all__ = ["ContactOutcome", "ContactResult"]


class ContactOutcome(Enum):
    """How a contact solve ended; the value holds the remedy."""

    CONVERGED = "the forces hold to the tolerance"
    NOT_CONVERGED = "the sweeps ran out: allow more, loosen the tolerance, or move the tool in smaller steps"
    IMMOVABLE = "the tool enters where the organ's supports do not yield: hold fewer nodes, or press elsewhere"
    MISSING = "the compliance of nodes in reach is not there: fill the blocks of nodes_in_reach before the solve"


@dataclass
class ContactResult:
    """What a contact does to tool and organ, reused from solve to solve; world frame.

    Attributes
    ----------
    force_N
        Force on the tool [N], shape (3,).
    torque_Nm
        Torque on the tool about its tip [N m], shape (3,).
    nodal_forces_N
        Forces on the organ's touchable nodes [N], shape (s, 3).
    outcome
        How the solve ended.
    iterations
        Gauss-Seidel sweeps.
    contacts
        Contact points that carry force.
    area_m2
        Area of the organ's surface, or of the shell, that these points stand for [m2].
    penetration_m
        Deepest penetration left [m].
    """

    force_N: Array
    torque_Nm: Array
    nodal_forces_N: Array
    compliance_m_N: Array = field(repr=False)
    outcome: ContactOutcome = ContactOutcome.CONVERGED
    iterations: int = 0
    contacts: int = 0
    area_m2: float = 0.0
    penetration_m: float = 0.0
    compliance_scale: float = field(default=1.0, repr=False)

    def displacement_m(self) -> Array:
        """Displacement of the touchable nodes under the contact forces [m], shape (s, 3); for drawing."""
        loaded = np.flatnonzero(self.nodal_forces_N.any(axis=1))
        columns = (3 * loaded[:, None] + np.arange(3)).ravel()
        moved: Array = self.compliance_scale * (self.compliance_m_N[:, columns] @ self.nodal_forces_N[loaded].ravel())
        return moved.reshape(-1, 3)
