"""Displacement, strain and stress of an organ under a hyperelastic law, from the forces on its surface."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, eye_array

from meshes.base.arrays import Array, Ints
from tissue.fem.fields import StressState
from tissue.fem.quasi_newton import QuasiNewton, Springs
from tissue.fem.shapes import gradient_slopes
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

__all__ = ["LargeFields", "cauchy_stress"]

TOLERANCE, STEPS = 1e-3, 100
"""Of a frame's equilibrium: greatest force that is not balanced over the greatest of the load; most steps."""
PLACES = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
"""Rows and columns of the components xx, yy, zz, yz, xz, xy."""


class LargeFields:
    """Answers of an organ to forces on its surface.

    Parameters
    ----------
    space
        Nodes and cells.
    law, cell_factors
        The law, and what its moduli are multiplied by in each cell, shape (m,).
    follower
        Makes what finds the equilibria; called when the first is asked for.
    touchable
        Nodes on which forces act, shape (t,).
    """

    def __init__(
        self,
        space: Space,
        law: Hyperelastic,
        cell_factors: Array,
        follower: Callable[[], QuasiNewton],
        touchable: Ints,
    ) -> None:
        self._space, self._law, self._cell_factors, self._touchable = space, law, cell_factors, touchable
        self._make = follower
        self.frames = self.unsettled = 0
        """Frames so far, and those whose equilibrium was not reached."""

    @cached_property
    def _follower(self) -> QuasiNewton:
        return self._make()

    def under(self, forces_N: Array, moved_m: Array) -> tuple[Array, StressState, Array]:
        """Compute displacement [m], stress in the middle of each cell, and reaction of the supports [N], both (n, 3).

        Parameters
        ----------
        forces_N
            Forces on the touchable nodes [N], shape (t, 3).
        moved_m
            Displacements of the touchable nodes in the tick of these forces [m], shape (t, 3).
        """
        load = np.zeros((self._space.node_count, 3))
        load[self._touchable] = forces_N
        springs, loaded = None, np.flatnonzero(forces_N.any(axis=1))
        if len(loaded):
            nodes = self._touchable[loaded]
            between = self._follower.at_rest.compliance_between(nodes)
            shares = csr_array(eye_array(self._space.node_count, format="csr")[nodes])
            springs = Springs.holding(shares, np.diag(between).reshape(-1, 3).mean(axis=1), moved_m[loaded])
        found = self._follower.follow(load, tolerance=TOLERANCE, step_limit=STEPS, springs=springs)
        self.frames += 1
        self.unsettled += found.residual > TOLERANCE
        stress = cauchy_stress(self._space, found.displacement_m, self._law, self._cell_factors)
        return found.displacement_m, stress, found.internal_N - found.load_N


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
