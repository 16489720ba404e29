"""Responses of a body to known loads: compliance of its supports, and first guesses of solves."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.conjugate_gradients import IterativeSolution, dot
from tissue.fem.solvers.held_body import rigid_modes
from tissue.models.tooth.body import ParticleBody

__all__ = ["FirstGuess", "SupportCompliance", "support_compliance"]


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
    motions = rigid_modes(body.grid.node_position_m, reference_m)
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


NULL_CUT = 1e-6
"""Relative cut of the scaled eigenvalues of the energies between solutions.

Eigenvalues below this share of the largest are errors of the solves.
"""


class FirstGuess:
    """Combination of earlier solutions that is closest, in energy, to the solution for a new load.

    With solutions u_i for loads f_i it solves ``(u_i . f_j) c_j = u_i . f``. The known part of a
    force that has grown, turned or moved then costs no iterations. If the body has changed since,
    the guess is a little worse.

    Parameters
    ----------
    kept
        Solutions that are always kept, shape (n, 3) each, and the load of each: the six of the
        support compliance.
    recent
        Number of latest solutions that are kept in addition. While a body is cut, two leave 3
        iterations and six leave 5, since the older ones belong to a fuller body.
    """

    def __init__(self, kept: list[tuple[Array, Array]], *, recent: int = 2) -> None:
        self._solutions = [moved.ravel() for moved, _ in kept]
        self._loads = [load.ravel() for _, load in kept]
        self._first = len(kept)
        self._most = len(kept) + recent
        self._energy = np.array(
            [[dot(u, f) for f in self._loads] for u in self._solutions]
        ).reshape(len(kept), len(kept))

    def add(self, displacement_m: Array, load_N: Array) -> None:
        """Store a solution and its load [m], [N], shape (n, 3), in place of the oldest."""
        if not load_N.any():
            return
        if len(self._solutions) == self._most:
            del self._solutions[self._first], self._loads[self._first]
            self._energy = np.delete(
                np.delete(self._energy, self._first, axis=0), self._first, axis=1
            )
        moved = displacement_m.ravel().copy()
        load = load_N.ravel().copy()
        self._solutions.append(moved)
        self._loads.append(load)
        column = np.array(
            [
                0.5 * (dot(u, load) + dot(moved, f))
                for u, f in zip(self._solutions, self._loads, strict=True)
            ]
        )
        self._energy = np.block(
            [[self._energy, column[:-1, None]], [column[None, :-1], column[-1:, None]]]
        )

    def __call__(self, load_N: Array) -> Array:
        """Return a guess of the displacement [m] for a load [N], shapes (n, 3)."""
        guess = np.zeros(load_N.size)
        load = load_N.ravel()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._energy), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(
            scale[:, None] * 0.5 * (self._energy + self._energy.T) * scale
        )
        if values.size and values[-1] > 0.0:
            modes = (scale[:, None] * vectors)[:, values > NULL_CUT * values[-1]]
            work = np.array([dot(u, load) for u in self._solutions])
            share = modes @ ((modes.T @ work) / values[values > NULL_CUT * values[-1]])
            for moved, each in zip(self._solutions, share, strict=True):
                guess += each * moved
        return guess.reshape(load_N.shape)
