"""Compliance of a body in its supports: six rigid motions for six loads."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.conjugate_gradients import IterativeSolution
from tissue.models.tooth.body import ParticleBody

__all__ = ["SupportCompliance", "rigid_motions", "support_compliance"]


@dataclass(frozen=True, eq=False)
class SupportCompliance:
    """Rigid motion of a part of a body for a wrench on it, both about a reference point.

    Attributes
    ----------
    matrix
        Translation [m] and rotation [rad] for force [N] and torque [N m], symmetric positive
        definite, shape (6, 6).
    reference_m
        The reference point [m], shape (3,).
    solutions
        The six solves; if any has not converged the matrix must not be used.
    loads_N
        Nodal forces of each [N], shape (n, 3).
    asymmetry
        Largest difference of the matrix from its transpose before it was made symmetric, relative
        to the geometric mean of the two diagonal entries.
    """

    matrix: Array
    reference_m: Array
    solutions: tuple[IterativeSolution, ...]
    loads_N: tuple[Array, ...]
    asymmetry: float

    @property
    def converged(self) -> bool:
        """True if all solves converged, so that the matrix may be used."""
        return all(solution.converged for solution in self.solutions)


def rigid_motions(position_m: Array, reference_m: Array) -> Array:
    """Return nodal displacements of unit rigid motions about a point.

    Positions of shape (n, 3) give shape (n, 3, 6).
    """
    motions = np.zeros((len(position_m), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = np.cross(np.eye(3)[None], (position_m - reference_m)[:, None, :]).transpose(
        0, 2, 1
    )
    return motions


def support_compliance(
    body: ParticleBody,
    *,
    weights: Array,
    reference_m: Array,
    tolerance: float = 1e-4,
    start: SupportCompliance | None = None,
) -> SupportCompliance:
    """Return the compliance of the part of a body where ``weights``, shape (n,), are not zero.

    The wrench is spread over the nodes as ``f = w R G^-1 q``. The rigid motion is the weighted
    least-squares fit ``G^-1 sum w R^T u``, with R the unit rigid motions and ``G = sum w R^T R``.
    The fit is the transpose of the spread, so the matrix is symmetric for any weights.

    Parameters
    ----------
    body
        The body, with its supports.
    weights
        Weight of each node, such as the volume of stiff material around it.
    reference_m
        Reference point of torque and rotation [m], shape (3,).
    tolerance
        Relative error in the energy norm of each solve.
    start
        An earlier result whose displacements the solves start from.
    """
    used = np.where(body.carrying, weights, 0.0)
    motions = rigid_motions(body.grid.node_position_m, reference_m)
    weighted = used[:, None, None] * motions
    gram = np.einsum("nik,nil->kl", weighted, motions)
    spread = np.einsum("nik,kl->nil", weighted, np.linalg.inv(gram))
    solutions: list[IterativeSolution] = []
    loads = [spread[:, :, column].copy() for column in range(6)]
    matrix = np.zeros((6, 6))
    kept = body.displacement_m
    for column in range(6):
        guess = None if start is None else start.solutions[column].displacement_m
        found = body.solve(loads[column], tolerance=tolerance, cold=start is None, start_m=guess)
        matrix[:, column] = np.einsum("nik,ni->k", spread, found.displacement_m)
        solutions.append(found)
    body.displacement_m = kept
    size = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    asymmetry = float((np.abs(matrix - matrix.T) / np.where(size > 0.0, size, 1.0)).max())
    return SupportCompliance(
        0.5 * (matrix + matrix.T), reference_m, tuple(solutions), tuple(loads), asymmetry
    )
