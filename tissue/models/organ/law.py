"""Hyperelastic law of a soft organ at 1 kHz.

Every tick uses a compliance and an offset of the displacement. The offset is computed between
ticks.

Under nodal forces f the surface of the organ moves by u(f). Near an equilibrium with displacement
u_k and forces f_k, this function is approximated with a compliance W::

    u(f) = W f + offset_k,    offset_k = u_k - W f_k

A contact that is solved with W and this offset satisfies the hyperelastic law if its forces are
f_k. At the end of every interval the equilibrium under the present forces is solved. During the
next interval, the offset changes gradually to the new offset. The offset also depends linearly on
the depth of the tool. The slope of this dependence is computed from the last two equilibria. At
first, W is the compliance at rest. When an equilibrium deviates too much from the prediction by W,
W is replaced by the compliance of the tangent stiffness at the present displacement (Newton's
method).

A run without a real device waits until the equilibrium is computed. With a real device, a second
thread computes the equilibrium, and the ticks continue with the last offset.

An organ that relaxes is quasi-linear viscoelastic (Fung 1993, Biomechanics, 2nd edition, chapter
7). The nodal forces of the organ are the hereditary integral of the elastic nodal forces, with one
reduced relaxation function. The inverse of this integral contains the creep function. Applied to
the nodal forces f, the inverse gives the crept forces (`tissue.models.organ.model`). The
displacement is the response of the elastic law to the crept forces: the equations above hold with
the crept forces in place of f. The integral keeps the directions of the forces fixed, so tissue
must not rotate much while it relaxes.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fem.quasi_newton import Followed, Springs
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import components_of
from tissue.models.organ.law_window import LawWindow, LawWindows
from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan, ToolPath
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import SLOW
from tissue.system.blas_threads import one_blas_thread

TOLERANCE = 1e-3
STEPS = 30
"""Largest number of solver steps for one equilibrium.

The solver stops earlier if the unbalanced force is at most `TOLERANCE` times the largest nodal
force. With a tolerance of 0.02 or 0.005, a change of an Ogden exponent from 18 to 18.1 changes the
force of a deep press by up to 3.8 %. With 0.001 this change is 0.4 %. The equilibria in
docs/decisions.md need at most 9 steps. With a limit of 5 steps, one equilibrium in eight does not
reach the tolerance.
"""
PREDICTION_TOLERANCE = 0.01
"""Relative error of a predicted displacement above which the compliance is computed again.

The prediction uses the compliance. If an old compliance is used too long, the force depends on the
time at which this compliance was computed. With 0.05 the force of a deep press decreases by 4 %
when an Ogden exponent increases from 15.5 to 16.5. With 0.02 some forces change by 4 %. With 0.01
the forces differ by at most 0.1 % from a computation with a new compliance in every interval.
"""
SLOPE_STEP_M = 2e-4
"""Smallest depth difference of two equilibria from which the offset's slope is computed [m].

With 5e-5 the force of a deep press does not change. With 8e-4 the largest force error while the
tool moves increases from 1.5 to 1.9 %.
"""
FARTHEST = 2.0
"""Largest change of depth over which the offset is extrapolated, as a ratio.

The change is divided by the depth difference of the two equilibria that define the offset's slope.
Without extrapolation, the largest force error while the tool moves in a deep press is 2.4 % instead
of 1.5 %. Values above 2 change nothing.
"""


STATE = (
    "latest_m",
    "_now",
    "_shown",
    "_apart",
    "_changed_s",
    "_next_s",
    "solves",
    "unsettled",
    "_late",
)
"""Names of the attributes on which later ticks and notices depend."""


@dataclass(frozen=True, eq=False)
class _Line:
    """Displacement offset as a linear function of the depth, within a limited range of depth."""

    at_m: Array
    slope: Array
    depth_m: float
    reach_m: float

    def into(self, out: Array, depth_m: float, share: float) -> None:
        """Add the offset at a depth, multiplied by `share`, to `out`."""
        beyond = min(max(depth_m - self.depth_m, -self.reach_m), self.reach_m)
        out += share * self.at_m
        out += (share * beyond) * self.slope


@dataclass(frozen=True, eq=False)
class _Equilibrium:
    """Equilibrium that a solver has found.

    Attributes
    ----------
    depth_m, tip_m
        Travel of the tool since the first touch [m], and position of the tool's tip [m], shape
        (3,). The position is NaN if the equilibrium is the state of rest.
    moved_m, forces_N
        Displacement of the window's touchable nodes [m], shape (w, 3), and forces on all touchable
        nodes [N], shape (t, 3).
    """

    depth_m: float
    tip_m: Array
    moved_m: Array
    forces_N: Array

    def is_aside(self, other: "_Equilibrium") -> bool:
        """Return True if the tool moved more sideways than along its axis between two equilibria.

        The result is False if one equilibrium is the state of rest, whose tip position is NaN.
        """
        deeper_m = self.depth_m - other.depth_m
        square = float(np.sum((self.tip_m - other.tip_m) ** 2)) - deeper_m**2
        return square > max(SLOPE_STEP_M, abs(deeper_m)) ** 2


@dataclass(eq=False)
class TickState:
    """State of a contact in one tick, for which the law is solved while the ticks continue.

    Attributes
    ----------
    nodal_forces_N, crept_N
        Contact forces, and crept forces (forces that would cause the present displacement without
        creep) [N], each of shape (t, 3).
    offset_m
        Offset in the tick [m], shape (t, 3): displacement according to the hyperelastic law minus
        displacement computed with the compliance.
    compliance_m_N
        Compliance of the contact nodes [m/N], shape (3t, 3t). The solver may replace it.
    tip_m
        Position of the tool's tip [m], shape (3,).
    is_renewed
        True if the solver has replaced the compliance.
    """

    nodal_forces_N: Array
    crept_N: Array
    offset_m: Array
    compliance_m_N: Array
    tip_m: Array
    is_renewed: bool = False

    def change_compliance(self, compliance_m_N: Array) -> None:
        """Replace the compliance."""
        self.compliance_m_N = compliance_m_N
        self.is_renewed = True


def _displaced(contact: TickState, forces_N: Array) -> Array:
    """Return the displacement [m], shape (t, 3), that forces cause by the contact's compliance."""
    return (contact.compliance_m_N @ forces_N.ravel()).reshape(-1, 3)


class LawOffset:
    """Offset of an organ: hyperelastic displacement minus the displacement by a compliance matrix.

    Parameters
    ----------
    organ, law
        The organ, and its hyperelastic law.
    touchable
        Nodes of the contact, shape (t,).
    tool
        The tool and its poses. The poses determine the windows (parts of the organ) in which the
        law is solved.

    Attributes
    ----------
    windows
        Windows along the path of the tool.
    """

    def __init__(self, organ: SoftOrgan, law: OrganLaw, touchable: Ints, tool: ToolPath) -> None:
        self.windows = LawWindows(organ, law, touchable, tool)
        self.interval_s = law.interval_s
        none = np.zeros((len(touchable), 3))
        self.latest_m = none.copy()
        """Offset of the last tick [m], shape (t, 3)."""
        self._now = _Line(none, none, 0.0, 0.0)
        self._shown = self._now, self._now
        inside = np.zeros((len(self.windows.now.inside), 3))
        at_rest = _Equilibrium(0.0, np.full(3, np.nan), inside, none)
        self._apart: _Equilibrium | None = at_rest
        self._factor: DirectSolver | None = self.windows.now.follower.factor
        self._at_rest: Array | None = None
        self._changed_s = 0.0
        self._next_s = law.interval_s
        self.notices: list[str] = []
        self.solves = self.unsettled = 0
        """Number of solves so far, and number of solves that did not reach the equilibrium."""
        self.took_s: list[float] = []
        """Duration of each solve so far [s]."""
        self._late = False
        self._thread: Executor | None = None
        self._pending: Future[TickState] | None = None

    def offset_m(self, time_s: float, depth_m: float) -> Array:
        """Return the present offset of the touchable nodes [m], shape (t, 3).

        The next call overwrites the returned array.
        """
        share = self._share(time_s)
        start, end = self._shown
        self.latest_m[:] = 0.0
        start.into(self.latest_m, depth_m, 1.0 - share)
        end.into(self.latest_m, depth_m, share)
        return self.latest_m

    def _share(self, time_s: float) -> float:
        """Return the completed share, 0 to 1, of the gradual change to the last computed offset."""
        if self.interval_s == 0.0:
            return 1.0
        return min((time_s - self._changed_s) / self.interval_s, 1.0)

    def start_thread(self) -> None:
        """Start the thread that computes equilibria; it has the priority of the caller."""
        self._second_thread().submit(int)

    def _second_thread(self) -> Executor:
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, thread_name_prefix="law")
        return self._thread

    def stop_thread(self) -> None:
        """End the second thread when it has finished the equilibrium that it is computing."""
        if self._thread is not None:
            self._thread.shutdown()
        self._thread = None
        self._pending = None

    def renew(
        self, time_s: float, depth_m: float, state: Callable[[], TickState], *, waits: bool
    ) -> TickState | None:
        """Solve for an equilibrium if an interval has ended, in this call or in a second thread.

        Return the state for which an equilibrium was found, or None if no equilibrium was found in
        this call. If the result is a state, the caller must call `show`.

        Parameters
        ----------
        time_s, depth_m
            Present time [s], and travel of the tool in contact [m].
        state
            Function that returns the state of the last tick.
        waits
            True to solve within this call. Otherwise a second thread solves, and a later call
            returns the state.
        """
        if self._pending is not None:
            if not (waits or self._pending.done()):
                return None
            done = self._pending.result()
            self._pending = None
            return done
        # 1e-9 s: the time of a tick is rounded.
        if time_s < self._next_s - 1e-9:
            return None
        self._next_s = time_s + self.interval_s
        if waits:
            return self.solve(depth_m, state())
        self._pending = self._second_thread().submit(self.solve, depth_m, state())
        return None

    def show(self, time_s: float, depth_m: float, held_m: Array | None) -> None:
        """Start the gradual change to the offset of the last equilibrium.

        Parameters
        ----------
        time_s, depth_m
            Present time [s], and travel of the tool in contact [m].
        held_m
            Offset [m], shape (t, 3), that keeps every node in place when the compliance is
            replaced. The change starts from this offset. None if the compliance was not replaced.
        """
        share = self._share(time_s)
        start, end = self._shown
        if held_m is not None:
            start = _Line(held_m, np.zeros_like(held_m), depth_m, 0.0)
        elif share < 1.0:
            slope = (1.0 - share) * start.slope + share * end.slope
            start = _Line(self.latest_m.copy(), slope, depth_m, end.reach_m)
        else:
            start = end
        self._shown = start, self._now
        self._changed_s = time_s

    def solve(self, depth_m: float, contact: TickState) -> TickState:
        """Solve for the equilibrium under the crept forces of ``contact``, and return ``contact``.

        Crept forces are the forces that would cause the present displacement if the tissue did not
        creep. If the organ does not relax, the crept forces equal the contact forces. The linear
        algebra always uses one thread, so the forces do not depend on the number of available
        threads.
        """
        with one_blas_thread():
            return self._solve(depth_m, contact)

    def _solve(self, depth_m: float, contact: TickState) -> TickState:
        crept_N = contact.crept_N
        started = perf_counter()
        indefinite = self.windows.indefinite
        if self.windows.choose(contact.nodal_forces_N, crept_N):
            # The solutions in the last window belong to other nodes.
            self._apart = None
            self._factor = None
        window = self.windows.now
        follower = window.follower
        found = follower.follow(
            window.spread(crept_N),
            tolerance=TOLERANCE,
            step_limit=STEPS,
            springs=self._springs(contact, crept_N),
        )
        forces = np.zeros_like(self.latest_m)
        forces[window.inside] = found.load_N[window.places]
        moved = found.displacement_m[window.places]
        expected = np.zeros_like(self.latest_m)
        self._now.into(expected, depth_m, 1.0)
        missed = moved - (_displaced(contact, forces) + expected)[window.inside]
        has_missed = np.linalg.norm(missed) > PREDICTION_TOLERANCE * np.linalg.norm(moved)
        # The tangent of a new window is computed at its first equilibrium, not at the first guess.
        if self._factor is None or (follower.factor is self._factor and has_missed):
            follower.take_stiffness()
        changed = follower.factor is not self._factor
        if changed:
            self._change_compliance(contact)
        assert self._factor is not None
        left = np.where(window.fixed, 0.0, found.load_N - found.internal_N)
        moved = moved + self._factor.displacement_m(left)[window.places]
        offset = self._offset(contact, moved, forces)
        # A new compliance is the tangent at this displacement, so the slope of the offset is
        # zero.
        slope = np.zeros_like(offset) if changed else self._now.slope
        reach_m = self._now.reach_m
        here = _Equilibrium(depth_m, contact.tip_m, moved, forces)
        # An equilibrium before a slide belongs to another place on the organ.
        if self._apart is None or here.is_aside(self._apart):
            self._apart = here
            slope = np.zeros_like(offset)
            reach_m = 0.0
        deeper_m = depth_m - self._apart.depth_m
        # With a smaller change of depth, the errors of two solves would be divided by almost zero.
        if abs(deeper_m) >= SLOPE_STEP_M:
            if not changed:
                last = self._offset(contact, self._apart.moved_m, self._apart.forces_N)
                slope = (offset - last) / deeper_m
            reach_m = FARTHEST * abs(deeper_m)
            self._apart = here
        self._now = _Line(offset, slope, depth_m, reach_m)
        self._report(found, perf_counter() - started, first=indefinite == 0)
        return contact

    def _springs(self, contact: TickState, crept_N: Array) -> Springs:
        """Build springs that hold the loaded nodes near their positions in the last tick.

        The springs have the compliance of the contact. Let w be the stiffness of the contact, k the
        stiffness of the tissue and s the stiffness of the springs. Each computed equilibrium
        multiplies the error of the contact force by a factor. The factor is (k - w) / (k + s) if
        the tool prescribes the displacement, and s (k - w) / (w (k + s)) if the tool prescribes the
        force. With s = w the two factors are equal: (k - w) / (k + w). The magnitude of this factor
        is below 1 for any tissue.
        """
        window = self.windows.now
        inside_N = np.zeros_like(crept_N)
        inside_N[window.inside] = crept_N[window.inside]

        def compliance(window: LawWindow, loaded: Ints) -> Array:
            columns = components_of(window.inside[loaded])
            return contact.compliance_m_N[np.ix_(columns, columns)]

        # Forces outside the window have no effect on the window, so the targets leave them
        # out.
        return window.springs(crept_N, _displaced(contact, inside_N) + contact.offset_m, compliance)

    def _offset(self, contact: TickState, moved_m: Array, forces_N: Array) -> Array:
        """Return the offset of all touchable nodes [m]; it is zero outside the window in use."""
        offset = np.zeros_like(self.latest_m)
        inside = self.windows.now.inside
        offset[inside] = moved_m - _displaced(contact, forces_N)[inside]
        return offset

    def _change_compliance(self, contact: TickState) -> None:
        """Replace the compliance of the contact by the compliance of the factor in use."""
        self._factor = self.windows.now.follower.factor
        contact.change_compliance(self._compliance(contact.compliance_m_N))

    def _compliance(self, present_m_N: Array) -> Array:
        """Return the compliance of the contact nodes [m/N] for the stiffness factor in use.

        Outside the window, the entries of the compliance at rest are used. In the first call,
        `present_m_N` must be the compliance at rest.
        """
        if self._at_rest is None:
            self._at_rest = present_m_N.copy()
        window = self.windows.now
        factor = window.follower.factor
        compliance = self._at_rest.copy()
        if factor is not window.follower.at_rest:
            rows = components_of(window.inside)
            compliance[np.ix_(rows, rows)] = factor.compliance_between(window.places)
        return compliance

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend.

        The second thread must not be in use.
        """
        return {"own": copied(self, STATE), "windows": self.windows.state()}

    def restore(self, state: State, present_m_N: Array) -> Array | None:
        """Restore a state that `state` has returned.

        Return the compliance of the contact in that state [m/N], shape (3t, 3t), or None if the
        present compliance stays in use.
        """
        before = self._factor
        put_back(self, state["own"])
        with one_blas_thread():
            self.windows.restore(state["windows"])
            self._factor = self.windows.now.follower.factor
            return None if self._factor is before else self._compliance(present_m_N)

    @property
    def late_share(self) -> float:
        """Share of the run time in which the offset was out of date by more than an interval.

        An equilibrium whose computation takes longer than an interval delays the next equilibrium.
        The share is the sum of these delays, divided by the sum of all intervals and delays.
        """
        if not self.took_s or self.interval_s == 0.0:
            return 0.0
        late = np.maximum(np.array(self.took_s) - self.interval_s, 0.0)
        return float(late.sum() / (late + self.interval_s).sum())

    def _report(self, found: Followed, took_s: float, *, first: bool) -> None:
        """Count an equilibrium, and add a notice for each kind of problem that occurs first."""
        self.solves += 1
        self.took_s.append(took_s)
        missed = found.residual > TOLERANCE
        self.unsettled += missed
        if first and self.windows.indefinite:
            self.notices.append(
                "the tangent stiffness of organ.law is not positive definite: only the tool "
                "keeps the tissue from "
                "yielding. It was replaced by a stiffer one; check the force here against a "
                "finer mesh"
            )
        if missed and self.unsettled == 1:
            self.notices.append(
                f"the law's equilibrium was not reached in {STEPS} steps: {found.residual:.0%} of "
                "the largest nodal force is not balanced. The equilibrium after "
                f"{found.reached:.0%} of the change of load is used instead"
            )
        if 0.0 < self.interval_s < took_s and not self._late:
            self._late = True
            effect = "the tick waits for the solution, so the force is unchanged"
            if self._thread is not None:
                effect = "the ticks continue with the last solution"
            self.notices.append(
                f"first slow solve of the law: it took {took_s:.3g} s, {SLOW} of "
                f"{self.interval_s:g} s. In this run {effect}"
            )
