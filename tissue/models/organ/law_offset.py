"""A hyperelastic organ at 1 kHz: the compliance at rest in every tick, and between ticks how far the law is from it.

Under nodal forces f the surface of the organ moves by u(f). Near an equilibrium u_k with the internal forces g_k, with
W the compliance at rest (one step of Newton's method with the stiffness at rest)::

    u(f) = W f + offset_k,    offset_k = u_k - K^-1 g_k on the surface

so that a contact on W with this offset is in equilibrium with the law as soon as u_k belongs to the forces that act. At
the end of every interval the equilibrium of the forces of that moment is found; the offset goes over to the new one
within the next interval, without a step. It follows the depth of the tool by its change since the last one. Solved
on a coarser mesh of the organ, K is that mesh's: its errors are nearly the same with the law and without.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.solvers.held_body import HeldBody
from tissue.models.tissue_model import SLOW

__all__ = ["LawOffset"]

TOLERANCE, STEPS = 0.02, 30
"""Of the forces that nothing balances at the end of a solve, over the greatest nodal force; most steps of a solve."""
TAKEN = 0.5
"""Share of what a solve changes that is taken: so that forces settle
where the organ is up to 4 times as compliant as at rest."""
APART_M = 2e-4
"""Least change of depth from which the change of the offset with it is taken [m]."""
FARTHEST = 2.0
"""How far that is followed, over the change of depth that it was taken from."""


@dataclass(frozen=True, eq=False)
class _Line:
    """The offset over the depth, shapes (t, 3), within a reach."""

    at_m: Array
    slope: Array
    depth_m: float
    reach_m: float

    def into(self, out: Array, depth_m: float, share: float) -> None:
        """Add a share of it at a depth."""
        beyond = min(max(depth_m - self.depth_m, -self.reach_m), self.reach_m)
        out += share * self.at_m
        out += (share * beyond) * self.slope


class LawOffset:
    """How far the touchable nodes of an organ are from where the compliance at rest has them.

    Parameters
    ----------
    follower
        The law's equilibria.
    body, solve
        Of the same mesh, stiffness at rest and supports, and displacement [m] under a load [N] by it, shape (n, 3).
    transfer
        Shares of that mesh's nodes in those that the contact knows, shape (t, n).
    interval_s
        Time between two solves [s].
    """

    def __init__(
        self,
        follower: QuasiNewton,
        body: HeldBody,
        solve: Callable[[Array], Array],
        transfer: csr_array,
        *,
        interval_s: float,
    ) -> None:
        self._follower, self._body, self._solve = follower, body, solve
        self._transfer, self._spread = transfer, csr_array(transfer.T)
        self.interval_s = interval_s
        none = np.zeros((transfer.shape[0], 3))
        self._offset = none.copy()
        self._before = self._now = _Line(none, none, 0.0, 0.0)
        self._apart: tuple[float, Array] = (0.0, none)
        self._changed_s, self._next_s = 0.0, interval_s
        self.notices: list[str] = []
        self._unsettled = self._late = False

    def offset_m(self, time_s: float, depth_m: float) -> Array:
        """The offset of the touchable nodes now [m], shape (t, 3), the same array each time."""
        share = min((time_s - self._changed_s) / self.interval_s, 1.0)
        self._offset[:] = 0.0
        self._before.into(self._offset, depth_m, 1.0 - share)
        self._now.into(self._offset, depth_m, share)
        return self._offset

    @property
    def latest_m(self) -> Array:
        """The offset of the last tick [m], shape (t, 3)."""
        return self._offset

    def renew(self, time_s: float, depth_m: float, forces_N: Array) -> None:
        """Where an interval ends, find the equilibrium of the forces on the touchable nodes, shape (t, 3)."""
        if time_s < self._next_s - 1e-9:
            return
        started = perf_counter()
        found = self._follower.follow(self._spread @ forces_N, tolerance=TOLERANCE, step_limit=STEPS)
        internal = np.where(self._body.fixed, 0.0, found.internal_N)
        at_rest = self._solve(internal) if internal.any() else internal
        offset_m = np.asarray(self._transfer @ (found.displacement_m - at_rest))
        expected_m = np.zeros_like(offset_m)
        self._now.into(expected_m, depth_m, 1.0)
        offset_m = expected_m + TAKEN * (offset_m - expected_m)
        last_m, last = self._apart
        slope, reach_m = self._now.slope, self._now.reach_m
        if abs(depth_m - last_m) >= APART_M:
            slope, reach_m = (offset_m - last) / (depth_m - last_m), FARTHEST * abs(depth_m - last_m)
            self._apart = (depth_m, offset_m)
        self._before, self._now = self._now, _Line(offset_m, slope, depth_m, reach_m)
        self._changed_s, self._next_s = time_s, time_s + self.interval_s
        self._report(found.residual, perf_counter() - started)

    def _report(self, residual: float, took_s: float) -> None:
        if residual > TOLERANCE and not self._unsettled:
            self._unsettled = True
            self.notices.append(
                f"the law's equilibrium was not reached in {STEPS} steps: {residual:.0%} of the greatest nodal force "
                "is not balanced"
            )
        if took_s > self.interval_s and not self._late:
            self._late = True
            self.notices.append(
                f"solving the law took {took_s:.2f} s, {SLOW} of {self.interval_s:g} s: the run waits for it, a device "
                "would not"
            )
