"""A hyperelastic body that moves in a few modes, its energy summed over some of its points.

With u = sum q_k phi_k, the gradient of u at a point is linear in q. Points x with volumes w of their own give the
energy ``sum w psi(I + grad u(x))``; forces and tangent are its derivatives, so a closed path does no work whatever
points are taken. A rotation costs no energy where the modes hold it. With every Gauss point and its own volume it is
the energy of the mesh in these modes.
"""

import numpy as np
import warp as wp

from kernels.sampled_stress import sampled_moduli, sampled_stress
from meshes.base.arrays import Array, Ints
from tissue.fem.shapes import gauss_points, gradient_slopes
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

__all__ = ["SampledBody"]


class SampledBody:
    """Energy, forces and tangent of a body by the amounts of its modes.

    Parameters
    ----------
    space
        Nodes and cells.
    law, cell_factors
        The law, and what its moduli are multiplied by in each cell, shape (m,).
    modes
        Displacements of the nodes [m], shape (3n, r).
    points, volumes_m3
        Gauss points, numbered cell by cell, and the volume each stands for [m3], shapes (p,); None for all with their
        own.
    """

    def __init__(
        self,
        space: Space,
        law: Hyperelastic,
        cell_factors: Array,
        modes: Array,
        *,
        points: Ints | None = None,
        volumes_m3: Array | None = None,
    ) -> None:
        at = gauss_points(space.order)
        slopes = np.einsum("aci,qi->qac", gradient_slopes(4, space.order), at)
        volumes = np.repeat(space.volumes_m3 / len(at), len(at))
        self.points = np.arange(len(volumes)) if points is None else points
        self.volumes_m3 = volumes[self.points] if volumes_m3 is None else volumes_m3
        cell, place = np.divmod(self.points, len(at))
        corners = np.asarray(space.gradients[0].numpy())[cell]
        slope = np.einsum("pac,pcj->paj", slopes[place], corners)
        moved = modes.reshape(space.node_count, 3, -1)[space.cell_nodes[cell]]
        self.gradients = np.einsum("paj,pair->pijr", slope, moved, optimize=True).reshape(9 * len(cell), -1)
        """Of the modes at the points, shape (9p, r)."""
        count = len(cell)
        gradient, stress = (wp.zeros((count, 9), dtype=wp.float64, device="cpu") for _ in range(2))
        energy = wp.zeros(count, dtype=wp.float64, device="cpu")
        moduli = wp.zeros((count, 9, 9), dtype=wp.float64, device="cpu")
        self._host = gradient.numpy().reshape(-1), energy.numpy(), stress.numpy().reshape(-1), moduli.numpy()
        factors = cell_factors[cell]
        constants = [self.volumes_m3, np.outer(factors, [law.bulk_Pa, law.shear_Pa])]
        constants += [np.array(law.terms) / [law.shear_Pa, 1.0], np.array(law.powers_Pa) / law.shear_Pa]
        inputs = [*(wp.array(each, dtype=wp.float64, device="cpu") for each in constants), gradient]
        self._stress, self._moduli = (
            wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device="cpu", record_cmd=True)
            for kernel, outputs in ((sampled_stress, [energy, stress]), (sampled_moduli, [moduli]))
        )

    @property
    def size(self) -> int:
        """Number of modes."""
        return int(self.gradients.shape[1])

    def energy_and_force(self, amounts: Array) -> tuple[float, Array]:
        """Energy [J], infinite where a point is turned over, and its derivative, both by amounts, shape (r,)."""
        energy, stress = self.stress(amounts)
        return float(energy.sum()), stress @ self.gradients

    def stress(self, amounts: Array) -> tuple[Array, Array]:
        """Energy of each point [J], shape (p,), and its derivative by the gradient there [J], shape (9p,); views."""
        gradient, energy, stress, _ = self._host
        np.matmul(self.gradients, amounts, out=gradient)
        self._stress.launch()
        return energy, stress

    def tangent(self, amounts: Array) -> Array:
        """Second derivative of the energy by amounts that turn no point over, symmetric, shape (r, r)."""
        gradient, _, _, moduli = self._host
        np.matmul(self.gradients, amounts, out=gradient)
        self._moduli.launch()
        each = np.matmul(moduli, self.gradients.reshape(-1, 9, self.size))
        tangent = self.gradients.T @ each.reshape(-1, self.size)
        return np.asarray(0.5 * (tangent + tangent.T))
