"""Soft organ under a probe: contact forces at every tick, and fields for display.

Three conditions are assumed: every modulus of the body relaxes with the same Prony series,
Poisson's ratio is constant, and the supports are rigid. The elastic-viscoelastic correspondence
principle then gives the displacement of the surface under any history of nodal forces f::

    u(t) = integral j(t - s) d(W f)(s),    W the instantaneous elastic compliance, j the creep function

(Lee 1955, Q. Appl. Math. 13:183). With the exact exponential step of each creep term, the
displacement at the next tick is::

    u = instant_factor W f + offset,

where instant_factor, slightly above 1, includes the creep within the tick, and the offset of each
surface node is known before the tick. A contact solver for elastic organs can therefore be used.
The solver only has to scale the compliance and to add the offset to the surface without contact.
The contact area may grow, shrink, move or vanish, with or without friction.

With a hyperelastic law the tissue is quasi-linear viscoelastic. The crept forces are::

    F(t) = integral j(t - s) df(s) = instant_factor f + H,    H the history of the forces

The displacement is u(F), the elastic response of the law to F. The law is solved between ticks
(`tissue.models.organ.law`) as u(F) = W F + law_offset. A tick therefore solves::

    u = instant_factor W f + (W H + law_offset)

W H is the offset of the linear organ. When the law replaces W, W H is computed anew from the
history of the forces.

A usual shortcut is to relax the elastic contact force. The shortcut is correct only while the
contact grows (Lee and Radok 1960, J. Appl. Mech. 27:438; Ting 1966, J. Appl. Mech. 33:845). When
the tool retreats, the surface rises slowly and separates from the tool, but with this shortcut the
surface still pulls on the tool. The method here and the shortcut are valid for small strains
without inertia. Neither method is valid if parts of the organ relax with different series. If only
the shear modulus relaxes, the methods are valid only for a Poisson's ratio near 0.5. Relaxation of
the bulk modulus has no effect in that case.
"""  # noqa: E501 a table

from dataclasses import dataclass
from math import inf

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fem.fields import FieldSeries
from tissue.materials.prony import HereditaryIntegral
from tissue.models.organ.compliance import ComplianceMethod
from tissue.models.organ.contact import ContactOutcome, SurfaceContact
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.law import LawOffset, TickState
from tissue.models.organ.probe import SphereProbe
from tissue.models.organ.soft_organ import SoftOrgan, ToolPath
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.system.blas_threads import one_blas_thread

LINEAR_ERROR = ((0.33, 0.05), (0.52, 0.1))
"""Pairs: depth divided by the radius of the ball, and relative error of the linear force.

The reference is the force of a neo-Hookean law. The depths were computed for a block, a procedural
liver and a scanned liver, with results of 0.31-0.36 and 0.51-0.55: `python
tests/bench/chart_liver.py`. The axisymmetric solver gives 0.34 and 0.50 for a layer with a
thickness of five radii, 0.26 and 0.38 for 2.5 radii, and 0.38 and 0.57 for ten radii.
"""
SETTLED = 1e-3
"""Relative change of the force at which solving contact and law in turn has converged."""
STATE = ("_ticks", "_unsettled", "_limits", "_touched_m", "_travel_m", "_tip_m", "_offset_m")
"""Names of the attributes in a copied state, in addition to contact, law and creep."""


@dataclass(frozen=True)
class ContactSolution:
    """Options of the contact between a tool and an organ.

    Attributes
    ----------
    method, basis_size
        Method used to compute the compliance of the touchable nodes, and number of vectors of a
        reduced basis. If the method is None, columns of the compliance are computed from the
        factorised stiffness and stored for the next tool.
    tolerance, sweeps
        Tolerance of the contact solver, and largest number of sweeps, see `SurfaceContact`. The
        defaults suit a tick of 1 ms.
    cores
        Number of processor cores that project the points of a shell onto the organ; default: all
        cores.
    """

    method: ComplianceMethod | None = None
    basis_size: int = 300
    tolerance: float = 1e-3
    sweeps: int = 100
    cores: int | None = None


class OrganModel:
    """Soft organ that is touched by a tool on a given path.

    Parameters
    ----------
    organ
        The organ at rest.
    tool
        The tool and its poses along the path.
    solution
        Options of the contact solver.
    interval_s
        Time between two frames of displacement and stress [s]; infinity if no frames are wanted.
    step_s
        Length of a tick [s].
    report
        Function that is called with the name of the present task.

    Attributes
    ----------
    contact
        Contact between the tool and the organ's touchable surface.
    touchable
        Nodes that the tool can touch, shape (t,).
    waits
        True if a tick waits until the equilibrium of a hyperelastic law is computed. Set this
        attribute to False for a real device, if possible before `place`. During a wait, the device
        holds its last force, and the stability check of the simulation loop does not include the
        wait.

    Raises
    ------
    InputError
        If the tool's path touches no surface node or only supported nodes, or if the compliance of
        the touchable nodes does not fit into memory.
    """

    measure_names: tuple[str, ...] = ("indentation_mm", "contact_points", "sweeps")

    def __init__(
        self,
        organ: SoftOrgan,
        tool: ToolPath,
        solution: ContactSolution = ContactSolution(),
        *,
        interval_s: float = inf,
        step_s: float = TICK_S,
        report: Progress = silent,
    ) -> None:
        space = organ.space
        probe = tool.probe
        touchable, faces = organ.touchable(tool)
        self.touchable = touchable
        compliance = organ.compliance(
            touchable, solution.method, basis_size=solution.basis_size, report=report
        )
        self.contact = SurfaceContact(
            space.nodes_m[touchable] + organ.rest[1][touchable],
            faces,
            compliance,
            probe,
            friction=organ.friction,
            tolerance=solution.tolerance,
            sweeps=solution.sweeps,
            device=space.device,
            cores=solution.cores,
        )
        with one_blas_thread():
            self._law = None if organ.law is None else LawOffset(organ, organ.law, touchable, tool)
        windows = None if self._law is None else self._law.windows
        self._fields = OrganFields(organ, touchable, interval_s=interval_s, windows=windows)
        self.waits = True
        self._step_s = step_s
        self.layer_names = organ.mesh.part_names
        parts = np.zeros(len(self.layer_names))
        np.add.at(parts, organ.mesh.part, organ.mesh.volumes_m3)
        self.start_m3 = parts
        self.removed_m3 = np.zeros(len(parts))
        self.notices: list[str] = []
        self._response = Response.empty(len(self.layer_names), len(self.measure_names))
        # The area of all contacts is reported in one layer: the most frequent layer of the
        # touchable nodes.
        part = np.zeros(space.node_count, np.int64)
        part[space.cell_nodes] = organ.mesh.part[:, None]
        self._layer = int(np.bincount(part[touchable]).argmax())
        self._touched_m = np.full(3, np.nan)
        self._unsettled = False
        self._ticks = 0
        # The depth up to which linear elasticity is accurate enough is known for a ball only.
        self._limits: list[tuple[float, float]] = []
        if isinstance(probe, SphereProbe) and self._law is None:
            self._limits = [(depth * probe.radius_m, error) for depth, error in LINEAR_ERROR]
        self._crept_N = self.contact.result.nodal_forces_N
        self._offset_m = np.zeros((len(touchable), 3))
        self._travel_m = 0.0
        self._tip_m = np.zeros(3)
        self._creep: HereditaryIntegral | None = None
        if organ.prony is not None:
            self._crept_N = np.zeros((len(touchable), 3))
            self._creep, self._forces = (
                HereditaryIntegral(organ.prony.retardation, self._crept_N.shape, step_s=step_s)
                for _ in range(2)
            )
            self.contact.scale_compliance(self._creep.instant_factor)

    @property
    def fields(self) -> FieldSeries:
        """Displacement, strain, stress and reaction forces, computed after the end of the run."""
        return self._fields.series

    def place(self, motion: ToolMotion) -> None:
        """Put the probe at its first pose, outside the organ."""
        if self._law is not None and not self.waits:
            self._law.start_thread()
        self.contact.place(motion.tip_m, motion.rotation)
        self._tip_m[:] = motion.tip_m

    def advance(self, motion: ToolMotion) -> None:
        """Move the probe to its new pose: press, slide or lift off."""
        self._ticks += 1
        result = self.contact.result
        if self._creep is not None:
            # The last tick ends here. `converge` may have changed its force.
            self._forces.advance(result.nodal_forces_N)
            self._creep.advance(result.displacement_m() / self._creep.instant_factor)
        if result.contacts > 0:
            self._travel_m += float((self._tip_m - motion.tip_m) @ motion.rotation[:, 2])
        self._tip_m[:] = motion.tip_m
        self._solve_contact(motion)
        if result.outcome is not ContactOutcome.CONVERGED and not self._unsettled:
            self._unsettled = True
            self.notices.append(f"the contact did not settle: {result.outcome.value}")

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend.

        The stiffness factorisation of a hyperelastic law is shared, not copied. A pickled state
        does not contain the factorisation.
        """
        creep = [copied(each, HereditaryIntegral.STATE) for each in self._integrals()]
        crept = self._crept_N.copy()
        return {
            "own": copied(self, STATE),
            "contact": self.contact.state(),
            "law": None if self._law is None else self._law.state(),
            "creep": creep,
            "crept_N": crept,
        }

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned.

        Raises
        ------
        InputError
            If the state belongs to an organ with another mesh, or with another kind of law or
            relaxation.
        """
        creeps = len(state["creep"]) > 0
        if (self._law is None) != (state["law"] is None) or (self._creep is None) == creeps:
            raise InputError(
                "snapshot",
                "be of an organ with the same law and relaxation",
                "another one",
                "make both loops from equal arguments",
            )
        self.contact.restore(state["contact"])
        if self._law is not None:
            compliance = self._law.restore(state["law"], self.contact.result.compliance_m_N)
            if compliance is not None:
                self.contact.use_compliance(compliance)
        put_back(self, state["own"])
        self._crept_N[:] = state["crept_N"]
        for each, kept in zip(self._integrals(), state["creep"], strict=True):
            put_back(each, kept)

    def _integrals(self) -> tuple[HereditaryIntegral, ...]:
        """Return the hereditary integrals, or an empty tuple if the tissue does not creep."""
        return () if self._creep is None else (self._creep, self._forces)

    def respond(self, motion: ToolMotion) -> Response:
        """Return force and torque on the probe."""
        result = self.contact.result
        response = self._response
        response.wrench[:3] = result.force_N
        response.wrench[3:] = result.torque_Nm
        response.edge[:] = response.wrench
        if result.contacts == 0:
            self._touched_m[:] = np.nan
        elif np.isnan(self._touched_m[0]):
            self._touched_m[:] = motion.tip_m
        response.engaged_m2[self._layer] = result.area_m2 if result.contacts else 0.0
        measures = response.measures
        measures[0] = 1e3 * self._depth_m(motion)
        while self._limits and measures[0] > 1e3 * self._limits[0][0]:
            depth, error = self._limits.pop(0)
            self.notices.append(
                f"pressed {1e3 * depth:.1f} mm deep: at larger depths, the force of the linear law "
                f"differs by more than {error:.0%} from the force of a hyperelastic law"
            )
        measures[1] = result.contacts
        measures[2] = result.iterations
        return response

    def wait_for_background(self, time_s: float) -> None:
        """Solve for the equilibrium of a hyperelastic law if an interval has ended."""
        if self._law is not None:
            # A tool may take two steps in the tick of its first contact.
            self._ticks = round(time_s / self._step_s)
            found = self._law.renew(time_s, self._travel_m, self._state, waits=self.waits)
            if found is not None:
                self._take(found, time_s)

    def converge(self, motion: ToolMotion, *, limit: int) -> float:
        """Solve contact and hyperelastic law in turn at the present pose until the force converges.

        Return the last change of the force, relative to the force. For a linear organ this change
        is 0, because the contact is solved once.

        Parameters
        ----------
        motion
            Pose of the tool in the last tick.
        limit
            Largest number of times that contact and law are solved.
        """
        result = self.contact.result
        changed = 0.0
        if self._law is None or result.contacts == 0:
            return changed
        for _ in range(limit):
            before_N = result.force_N.copy()
            time_s = self._ticks * self._step_s
            self._take(self._law.solve(self._travel_m, self._state()), time_s)
            self._solve_contact(motion)
            # 1e-12 N avoids a division by zero if the contact has lost its force.
            size_N = max(float(np.linalg.norm(result.force_N)), 1e-12)
            changed = float(np.linalg.norm(result.force_N - before_N)) / size_N
            if changed <= SETTLED:
                break
        return changed

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Store the contact forces if a frame of the display is due."""
        # 1e-9 s: the time of a tick is rounded.
        if time_s >= self._fields.next_s - 1e-9:
            forces = self.contact.result.nodal_forces_N
            moved = None if self._law is None else self.displacement_m()
            self._fields.keep(time_s, forces, self._crept_N, moved)

    def finish(self) -> None:
        """Stop the background work, and compute the displayed fields at all stored times."""
        if self._law is not None:
            self._law.stop_thread()
        with one_blas_thread():
            self._fields.compute()
        self.notices += self._fields.notices
        self._fields.notices.clear()

    def summary(self) -> dict[str, object]:
        """Return solver statistics of a hyperelastic law, for the summary of the run.

        The dictionary is empty for a linear organ.
        """
        if self._law is None:
            return {}
        return {
            "law": {
                "solves": self._law.solves,
                "not_reached": self._law.unsettled,
                "indefinite_tangents": self._law.windows.indefinite,
                "solve_ms": {
                    "median": 1e3 * float(np.median(self._law.took_s or [0.0])),
                    "p99": 1e3 * float(np.percentile(self._law.took_s or [0.0], 99)),
                },
                "offset_older_than_interval": self._law.late_share,
            }
        }

    def displacement_m(self) -> Array:
        """Return the displacement of the touchable nodes in the last tick [m], shape (t, 3)."""
        return self.contact.result.displacement_m() + self._offset_m

    def _solve_contact(self, motion: ToolMotion) -> None:
        """Solve the contact at a pose, with the offsets from creep and from the law."""
        offset = self._offset_m
        if self._creep is not None:
            offset[:] = self._creep.history
        if self._law is not None:
            lawful = self._law.offset_m(self._ticks * self._step_s, self._travel_m)
            if self._creep is None:
                offset[:] = lawful
            else:
                offset += lawful
        if self._creep is not None or self._law is not None:
            self.contact.shift(offset)
        forces = self.contact.solve(motion.tip_m, motion.rotation).nodal_forces_N
        if self._creep is not None:
            np.multiply(forces, self._forces.instant_factor, out=self._crept_N)
            self._crept_N += self._forces.history

    def _state(self) -> TickState:
        """Return the contact state of the last tick, from which the law is solved."""
        assert self._law is not None
        result = self.contact.result
        return TickState(
            result.nodal_forces_N.copy(),
            self._crept_N.copy(),
            self._law.latest_m.copy(),
            result.compliance_m_N,
            self._tip_m.copy(),
        )

    def _take(self, found: TickState, time_s: float) -> None:
        """Use a new offset and compliance of the law, without a jump of the displacement."""
        law = self._law
        assert law is not None
        held = None
        if found.is_renewed:
            held = self.displacement_m()
            self.contact.change_compliance(found.compliance_m_N)
            held -= self.contact.result.displacement_m()
            if self._creep is not None:
                self._creep.become(
                    self._forces,
                    lambda force: (found.compliance_m_N @ force.ravel()).reshape(-1, 3),
                )
                held -= self._creep.history
        law.show(time_s, self._travel_m, held)
        self.notices += law.notices
        law.notices.clear()

    def _depth_m(self, motion: ToolMotion) -> float:
        """Return the tool's travel along its axis since the first touch [m]; 0 without contact."""
        if np.isnan(self._touched_m[0]):
            return 0.0
        return float((self._touched_m - motion.tip_m) @ motion.rotation[:, 2])
