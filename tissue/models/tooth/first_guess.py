"""A first guess from what was solved before: the best in energy of all their combinations."""

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.conjugate_gradients import dot

__all__ = ["FirstGuess"]

NULL_CUT = 1e-6
"""Scaled eigenvalues of the energies between solutions below this share of the largest are errors of the solves."""


class FirstGuess:
    """Combination of earlier solutions that is closest, in energy, to the one for a new load.

    With solutions u_i for loads f_i it solves ``(u_i . f_j) c_j = u_i . f``: a force that grew, turned or moved
    costs no iterations for the part that is known. The body may have changed since: the guess is a little worse then.

    Parameters
    ----------
    kept
        Solutions that are kept for good, shape (n, 3) each, and the load of each: the six of the support compliance.
    recent
        How many of the last solutions are kept besides: while a body is cut, two
        leave 3 iterations and six leave 5, since the older ones are of a body that was fuller.
    """

    def __init__(self, kept: list[tuple[Array, Array]], *, recent: int = 2) -> None:
        self._solutions = [moved.ravel() for moved, _ in kept]
        self._loads = [load.ravel() for _, load in kept]
        self._first, self._most = len(kept), len(kept) + recent
        self._energy = np.array([[dot(u, f) for f in self._loads] for u in self._solutions]).reshape(
            len(kept), len(kept)
        )

    def add(self, displacement_m: Array, load_N: Array) -> None:
        """Keep a solution and its load [m], [N], shape (n, 3), in place of the oldest."""
        if not load_N.any():
            return
        if len(self._solutions) == self._most:
            del self._solutions[self._first], self._loads[self._first]
            self._energy = np.delete(np.delete(self._energy, self._first, axis=0), self._first, axis=1)
        moved, load = displacement_m.ravel().copy(), load_N.ravel().copy()
        self._solutions.append(moved)
        self._loads.append(load)
        column = np.array(
            [0.5 * (dot(u, load) + dot(moved, f)) for u, f in zip(self._solutions, self._loads, strict=True)]
        )
        self._energy = np.block([[self._energy, column[:-1, None]], [column[None, :-1], column[-1:, None]]])

    def __call__(self, load_N: Array) -> Array:
        """Guess of the displacement [m] for a load [N], shapes (n, 3)."""
        guess, load = np.zeros(load_N.size), load_N.ravel()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._energy), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(scale[:, None] * 0.5 * (self._energy + self._energy.T) * scale)
        if values.size and values[-1] > 0.0:
            modes = (scale[:, None] * vectors)[:, values > NULL_CUT * values[-1]]
            work = np.array([dot(u, load) for u in self._solutions])
            share = modes @ ((modes.T @ work) / values[values > NULL_CUT * values[-1]])
            for moved, each in zip(self._solutions, share, strict=True):
                guess += each * moved
        return guess.reshape(load_N.shape)
