"""Hyperelastic law of a soft organ at 1 kHz.

Hyperelastic organ at 1 kHz: a compliance for every tick, and an offset solved between ticks.

Under nodal forces f the surface of the organ moves by u(f). Near an equilibrium u_k, f_k, with W a
compliance::

    u(f) = W f + offset_k,    offset_k = u_k - W f_k

A contact on W with this offset is therefore in equilibrium with the law as soon as the acting
forces are f_k. At the end of every interval the equilibrium of the forces of that moment is solved.
The offset changes to the new one within the next interval, without a step. It follows the depth of
the tool by the change of the offset since the last equilibrium. W is the compliance at rest until
the equilibria are far from it. Then W is the compliance of the tangent stiffness at the present
displacement (Newton's method).
"""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.sparse import bsr_array, csr_array, eye_array

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import Followed, QuasiNewton, Springs
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, components_of
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.compliance import FACTOR_UNKNOWNS
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan
from tissue.models.tissue_model import SLOW

__all__ = ["LawOffset", "follower_of"]

TOLERANCE = 0.02
STEPS = 30
"""Unbalanced force at the end of a solve, over the largest nodal force; largest number of steps.

From 0.005 to 0.1, the force of a deep press (neo-Hookean, Yeoh) changes by at most 0.4 %. The
solves of docs/decisions.md need at most 9 steps; with a limit of 5, one in eight is not reached.
"""
MISSED = 0.05
"""Deviation of an equilibrium from the expected one above which the compliance is renewed.

The deviation is relative to the displacement.

A compliance that is kept too long lets forces wander from interval to interval. From 0.01 to 0.2,
the force of a deep press changes by at most 0.4 %.
"""
APART_M = 2e-4
"""Smallest change of depth from which the slope of the offset is computed [m].

With 5e-5 a deep press has the same force; with 8e-4 the largest error of the moving tool grows
from 1.5 to 1.9 %.
"""
FARTHEST = 2.0
"""Longest extrapolation of the offset, over the change of depth that its slope was computed from.

Without extrapolation, the largest error of the moving tool in a deep press is 2.4 instead of 1.5 %.
Beyond 2 nothing changes.
"""


def follower_of(
    organ: SoftOrgan, law: Hyperelastic, cell_factors: Array, nodes: Ints
) -> QuasiNewton:
    """Return the solver that follows the equilibria of an organ.

    Its factors hold the compliance between some nodes.

    Raises
    ------
    InputError
        If the mesh is too large for a factor.
    """
    at_rest = organ.factor.solver
    if not isinstance(at_rest, DirectSolver):
        raise InputError(
            "organ.law",
            f"be linear on more than {FACTOR_UNKNOWNS:,} unknowns",
            f"{len(organ.body.free):,}",
            "use longer edges",
        )

    def factorised(stiffness: bsr_array) -> DirectSolver:
        return DirectSolver(HeldBody(stiffness, organ.space.nodes_m, organ.body.fixed), last=nodes)

    body = NonlinearBody(organ.space, None, law=law, cell_factors=cell_factors)
    return QuasiNewton(body, organ.body.fixed, at_rest, factorised)


@dataclass(frozen=True, eq=False)
class _Line:
    """Offset as a linear function of the depth, shapes (t, 3), within a reach."""

    at_m: Array
    slope: Array
    depth_m: float
    reach_m: float

    def into(self, out: Array, depth_m: float, share: float) -> None:
        """Add a share of the offset at a depth to `out`."""
        beyond = min(max(depth_m - self.depth_m, -self.reach_m), self.reach_m)
        out += share * self.at_m
        out += (share * beyond) * self.slope


def _displaced(contact: SurfaceContact, forces_N: Array) -> Array:
    """Return the displacement [m] of touchable nodes by the contact's compliance, shape (t, 3)."""
    moved: Array = contact.result.compliance_m_N @ forces_N.ravel()
    return moved.reshape(-1, 3)


class LawOffset:
    """Difference between the touchable nodes of an organ and their positions by a compliance.

    Parameters
    ----------
    organ, law
        The organ, and its law.
    touchable
        Nodes of the contact, shape (t,).
    """

    def __init__(self, organ: SoftOrgan, law: OrganLaw, touchable: Ints) -> None:
        self._follower = follower_of(organ, law.law, law.cell_factors, touchable)
        self._nodes = touchable
        self._fixed = organ.body.fixed
        self._shares = csr_array(eye_array(organ.space.node_count, format="csr")[touchable])
        self.interval_s = law.interval_s
        none = np.zeros((len(touchable), 3))
        self.latest_m = none.copy()
        """Offset of the last tick [m], shape (t, 3)."""
        self._before = self._now = _Line(none, none, 0.0, 0.0)
        self._apart = (0.0, none, none)
        self._factor = self._follower.factor
        self._changed_s = 0.0
        self._next_s = law.interval_s
        self.notices: list[str] = []
        self.solves = self.unsettled = 0
        """Numbers of solves so far, and of solves whose equilibrium was not reached."""
        self._late = False

    def offset_m(self, time_s: float, depth_m: float) -> Array:
        """Return the present offset of the touchable nodes [m], shape (t, 3).

        Every call returns one reused array.
        """
        share = 1.0
        if self.interval_s > 0.0:
            share = min((time_s - self._changed_s) / self.interval_s, 1.0)
        self.latest_m[:] = 0.0
        self._before.into(self.latest_m, depth_m, 1.0 - share)
        self._now.into(self.latest_m, depth_m, share)
        return self.latest_m

    def renew(self, time_s: float, depth_m: float, contact: SurfaceContact) -> None:
        """Solve for the equilibrium under the contact forces at the end of an interval.

        The solution sets the offset of the next interval. Within an interval nothing is done.
        """
        # 1e-9 s: the time of a tick is rounded.
        if time_s >= self._next_s - 1e-9:
            self.solve(time_s, depth_m, contact)

    def solve(self, time_s: float, depth_m: float, contact: SurfaceContact) -> None:
        """Solve for the equilibrium under the present contact forces."""
        started = perf_counter()
        indefinite = self.indefinite
        load = np.zeros(self._fixed.shape)
        load[self._nodes] = contact.result.nodal_forces_N
        found = self._follower.follow(
            load, tolerance=TOLERANCE, step_limit=STEPS, springs=self._springs(contact)
        )
        forces = found.load_N[self._nodes]
        moved = found.displacement_m[self._nodes]
        self._now.into(expected := np.zeros_like(self.latest_m), depth_m, 1.0)
        missed = float(np.linalg.norm(moved - _displaced(contact, forces) - expected))
        if self._follower.factor is self._factor and missed > MISSED * float(np.linalg.norm(moved)):
            self._follower.take_stiffness()
        if self._follower.factor is not self._factor:
            self._change_compliance(contact, forces, depth_m)
        left = np.where(self._fixed, 0.0, found.load_N - found.internal_N)
        moved = moved + self._factor.solve(left).displacement_m[self._nodes]
        offset = moved - _displaced(contact, forces)
        last_m, *last = self._apart
        slope = self._now.slope
        reach_m = self._now.reach_m
        # A smaller change of depth would divide the noise of two solves by almost zero.
        if abs(depth_m - last_m) >= APART_M:
            slope = (offset - (last[0] - _displaced(contact, last[1]))) / (depth_m - last_m)
            reach_m = FARTHEST * abs(depth_m - last_m)
            self._apart = (depth_m, moved, forces)
        self._before = self._now
        self._now = _Line(offset, slope, depth_m, reach_m)
        self._changed_s = time_s
        self._next_s = time_s + self.interval_s
        self._report(found, perf_counter() - started, first=indefinite == 0)

    def _springs(self, contact: SurfaceContact) -> Springs:
        """Build springs that hold the nodes under the tool near their last contact positions.

        They have the compliance of the contact. Let w be its stiffness, k that of the tissue and s
        that of the springs. An error of the contact force then decays from solve to solve by
        (k - w) / (k + s) where the tool prescribes the displacement, and by s (k - w) / w (k + s)
        where it prescribes the force. With s = w both are (k - w) / (k + w), less than 1 for any
        tissue.
        """
        forces_N = contact.result.nodal_forces_N
        # A held node needs no spring, and has no compliance.
        loaded = np.flatnonzero(forces_N.any(axis=1) & ~self._fixed[self._nodes].any(axis=1))
        if not len(loaded):
            return Springs.none(self._fixed.size)
        held_m = contact.result.displacement_m() + self.latest_m
        columns = components_of(loaded)
        compliance = contact.result.compliance_m_N[np.ix_(columns, columns)]
        return Springs.holding(self._shares[loaded], compliance, held_m[loaded])

    def _change_compliance(self, contact: SurfaceContact, forces_N: Array, depth_m: float) -> None:
        """Use the compliance of the stiffness that was factorised last.

        No node moves by the change.
        """
        self._factor = self._follower.factor
        at_m = _displaced(contact, forces_N)
        contact.change_compliance(self._factor.compliance_between(self._nodes))
        at_m -= _displaced(contact, forces_N)
        self._now.into(at_m, depth_m, 1.0)
        self._now = _Line(at_m, self._now.slope, depth_m, self._now.reach_m)

    @property
    def indefinite(self) -> int:
        """Number of tangents so far that were not positive definite."""
        return self._follower.indefinite

    def _report(self, found: Followed, took_s: float, *, first: bool) -> None:
        """Count the solve, and report events that happen for the first time."""
        self.solves += 1
        self.unsettled += found.residual > TOLERANCE
        if first and self.indefinite:
            self.notices.append(
                "the tangent stiffness of organ.law is not positive definite: only the tool "
                "keeps the tissue from "
                "yielding. It was replaced by a stiffer one; check the force here against a "
                "finer mesh"
            )
        if found.residual > TOLERANCE and self.unsettled == 1:
            self.notices.append(
                f"the law's equilibrium was not reached in {STEPS} steps: {found.residual:.0%} of "
                "the largest nodal force is not balanced. The equilibrium after "
                f"{found.reached:.0%} of the change of load is used instead"
            )
        if 0.0 < self.interval_s < took_s and not self._late:
            self._late = True
            self.notices.append(
                f"solving the law took {took_s:.2f} s, {SLOW} of {self.interval_s:g} s: the "
                "run waits for it, a device "
                "would not"
            )
