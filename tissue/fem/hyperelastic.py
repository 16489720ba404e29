"""Tetrahedra under large deformation: energy, nodal forces and tangent stiffness.

Hyperelastic laws are too slow for a tick of 1 ms. Linear tetrahedra lock if Poisson's ratio is near
0.5. Quadratic tetrahedra with four Gauss points do not lock.
"""

from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import bsr_array, csr_array

from kernels.launcher import SplitLaunch
from kernels.mirror import placed
from kernels.tet_hyperelastic import (
    gather_blocks,
    gather_forces,
    stretch_force,
    stretch_stiffness,
)
from meshes.base.arrays import Array, Ints
from tissue.fem.space import Space, gauss_points, gradient_slopes, local_pairs
from tissue.materials.hyperelasticity import Hyperelastic


class NonlinearBody:
    """Meshed body with a hyperelastic law.

    Parameters
    ----------
    space
        Nodes and cells, linear or quadratic.
    law
        Hyperelastic law.
    cell_factors
        Factor on the law's moduli for each cell, shape (m,). None if all factors are 1.
    membrane
        Stiffness of a linear membrane on the surface [N/m], shape (3n, 3n), as returned by
        `tissue.fem.assembly.capsule_stiffness`; None for no membrane.
    """

    def __init__(
        self,
        space: Space,
        *,
        law: Hyperelastic,
        cell_factors: Array | None = None,
        membrane: bsr_array | None = None,
    ) -> None:
        self.space = space
        self._membrane = membrane
        if membrane is not None:
            self._membrane_places = _places_of(membrane, space)
        self.law = law
        self.nodes_m = space.nodes_m
        device = space.device
        count, width = space.cell_nodes.shape
        at = gauss_points(space.order)
        reference = np.einsum("aci,qi->qac", gradient_slopes(4, space.order), at)
        first, second = local_pairs(width).T
        pattern = space.pattern
        node_place = np.argsort(space.cell_nodes.ravel(), kind="stable")
        node_start = np.concatenate(
            [[0], np.cumsum(np.bincount(space.cell_nodes.ravel(), minlength=space.node_count))]
        )

        def out(shape: int | tuple[int, int], dtype: type) -> Any:
            return wp.zeros(shape, dtype, device)

        self._displacement = out(space.node_count, wp.vec3d)
        self._energy = out(count, wp.float64)
        self._force = out(space.node_count, wp.vec3d)
        self._blocks = out(len(pattern.column), wp.mat33d)
        shares = out((count, width), wp.vec3d)
        squares = out((count, len(first)), wp.mat33d)
        each = np.ones(count) if cell_factors is None else cell_factors
        constants = [
            np.outer(each, [law.bulk_Pa, law.shear_Pa]),
            np.reshape(law.terms, (-1, 2)) / [law.shear_Pa, 1.0],
            np.array(law.powers_Pa) / law.shear_Pa,
            np.reshape(law.exponentials, (-1, 2)) / [law.shear_Pa, 1.0],
        ]
        points = [reference, np.full(len(at), 1.0 / len(at))]
        model = placed(
            stretch_force,
            [space.cell_nodes, *space.gradients, *points, *constants, self._displacement],
            device,
        )
        self._force_launches = (
            SplitLaunch(stretch_force, count, model, [self._energy, shares]),
            SplitLaunch(
                gather_forces,
                space.node_count,
                [node_start, node_place, shares.flatten()],
                [self._force],
            ),
        )
        places = [pattern.pair_start, pattern.contribution, pattern.place, pattern.mirror]
        gather = SplitLaunch(
            gather_blocks,
            len(pattern.place),
            [*places, squares.flatten()],
            [self._blocks],
        )
        self._stiffness_launches = [
            (
                SplitLaunch(stretch_stiffness, count, [first, second, definite, *model], [squares]),
                gather,
            )
            for definite in (0, 1)
        ]

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        """Return the elastic energy [J] and the internal nodal forces [N], shape (n, 3).

        The forces are the derivative of the energy with respect to the displacement. The energy is
        infinite if a cell is inverted.
        """
        self._displacement.assign(np.ascontiguousarray(displacement_m, dtype=np.float64))
        for run in self._force_launches:
            run()
        energy = float(self._energy.numpy().sum())
        force: Array = self._force.numpy().copy()
        if self._membrane is not None:
            moved = np.asarray(displacement_m, np.float64).ravel()
            pull = self._membrane @ moved
            energy += 0.5 * float(moved @ pull)
            force += pull.reshape(-1, 3)
        return energy, force

    def stiffness(self, displacement_m: Array, *, definite: bool = False) -> bsr_array:
        """Return the tangent stiffness [N/m] at a displacement, shape (3n, 3n).

        The matrix is bitwise symmetric. The displacement must not invert a cell.

        Parameters
        ----------
        displacement_m
            Displacement of the nodes [m], shape (n, 3).
        definite
            If true, the tangent at each quadrature point is changed so that its eigenvalues are
            positive. The matrix is then positive definite if the supports prevent rigid motions.
        """
        self._displacement.assign(np.ascontiguousarray(displacement_m, dtype=np.float64))
        for run in self._stiffness_launches[int(definite)]:
            run()
        pattern = self.space.pattern
        size = self.space.unknown_count
        blocks = self._blocks.numpy().copy()
        if self._membrane is not None:
            blocks[self._membrane_places] += self._membrane.data
        return bsr_array((blocks, pattern.column, pattern.row_start), shape=(size, size))


def _places_of(membrane: bsr_array, space: Space) -> Ints:
    """Return the positions of a membrane's blocks among the blocks of the space's stiffness."""
    pattern = space.pattern
    count = space.node_count
    numbered = csr_array(
        (np.arange(len(pattern.column)), pattern.column, pattern.row_start), shape=(count, count)
    )
    row = np.repeat(np.arange(count), np.diff(membrane.indptr))
    return np.asarray(numbered[row, membrane.indices]).ravel()
