"""Displacement, strain and stress of an organ under a hyperelastic law, from the forces on its surface."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.fields import StressState
from tissue.fem.shapes import gradient_slopes
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.law_offset import LawOffset

__all__ = ["LargeFields", "OrganLaw", "cauchy_stress"]

TOLERANCE, STEPS = 1e-3, 100
"""Of a frame's equilibrium: greatest force that is not balanced over the greatest of the load; most steps."""
PLACES = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
"""Rows and columns of the components xx, yy, zz, yz, xz, xy."""


@dataclass(frozen=True, eq=False)
class OrganLaw:
    """A hyperelastic law of an organ.

    Attributes
    ----------
    law
        The law of a cell whose factor is 1.
    cell_factors
        What its moduli are multiplied by in each cell, shape (m,).
    interval_s
        Time between two solves, between ticks [s].
    """

    law: Hyperelastic
    cell_factors: Array
    interval_s: float


class LargeFields:
    """Answers of an organ to forces on its surface.

    Parameters
    ----------
    space
        Nodes and cells.
    law
        What they are made of.
    offset
        Whose equilibria they are.
    """

    def __init__(self, space: Space, law: OrganLaw, offset: LawOffset) -> None:
        self._space, self._law, self._offset = space, law, offset

    def under(self, forces_N: Array) -> tuple[Array, StressState, Array]:
        """Displacement [m], stress in the middle of each cell, and reaction of the supports [N], both (n, 3).

        Parameters
        ----------
        forces_N
            On the touchable nodes, shape (t, 3).
        """
        found = self._offset.equilibrium(forces_N, tolerance=TOLERANCE, step_limit=STEPS)
        stress = cauchy_stress(self._space, found.displacement_m, self._law.law, self._law.cell_factors)
        return found.displacement_m, stress, found.internal_N - self._offset.load(forces_N)


def cauchy_stress(space: Space, displacement_m: Array, law: Hyperelastic, cell_factors: Array) -> StressState:
    """Cauchy stress and logarithmic strain in the middle of each cell, in the frame of space.

    Parameters
    ----------
    space, displacement_m
        Nodes and cells, and how far the nodes are moved [m], shape (n, 3).
    law, cell_factors
        The law, and what its moduli are multiplied by in each cell, shape (m,).
    """
    corners = np.asarray(space.gradients[0].numpy())
    shape = np.einsum("aci,i->ac", gradient_slopes(4, space.order), np.full(4, 0.25))
    gradient = np.eye(3) + np.einsum("mai,ac,mcj->mij", displacement_m[space.cell_nodes], shape, corners, optimize=True)
    turned = gradient.transpose(0, 2, 1)
    stress = law.stress(gradient) @ turned * (cell_factors / np.linalg.det(gradient))[:, None, None]
    size, frame = np.linalg.eigh(gradient @ turned)
    strain = np.einsum("mik,mk,mjk->mij", frame, 0.5 * np.log(size), frame)
    deviator = stress - np.eye(3) * (np.trace(stress, axis1=1, axis2=2) / 3.0)[:, None, None]
    row, column = PLACES.T
    return StressState(
        strain[:, row, column],
        stress[:, row, column],
        np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))),
        np.linalg.eigvalsh(stress)[:, ::-1],
    )
