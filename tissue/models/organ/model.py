"""Soft organ under a probe: contact at every tick, and fields where a frame is due.

Three conditions are assumed: every modulus of the body relaxes by one Prony series, Poisson's ratio
is constant and the supports are rigid. The elastic-viscoelastic correspondence then gives the
displacement of the surface under any history of nodal forces f::

    u(t) = integral j(t - s) d(W f)(s),    W the instantaneous elastic compliance, j the creep function

(Lee 1955, Q. Appl. Math. 13:183). One tick further, with the exact exponential step of each creep
term::

    u = instant_factor W f + offset,

where the offset per surface node is known before the tick. A contact solver uses the scaled
compliance, adds the offset to the free surface and needs no other change. It may have any
unilateral condition, with or without friction, for a contact that grows, shrinks, moves or lifts
off.

The usual shortcut, to relax the elastic force, is right only while the contact grows (Lee and Radok
1960, J. Appl. Mech. 27:438; Ting 1966, J. Appl. Mech. 33:845). When the tool retreats, this
shortcut pulls on the tool although the surface, which rises slowly, has separated. Both methods
hold for small strains without inertia. Neither holds where parts relax by different series. Neither
holds where the shear modulus relaxes alone, unless the bulk modulus is so large that this has no
effect (Poisson's ratio near 0.5).
"""  # noqa: E501 a table

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fem.fields import FieldSeries
from tissue.fem.solvers.lazy_compliance import LazyCompliance
from tissue.fem.space import Space
from tissue.materials.prony import HereditaryIntegral, Prony
from tissue.models.organ.contact import ContactOutcome, SurfaceContact
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.law_offset import LawOffset
from tissue.models.tissue_model import TICK_S, Response, ToolMotion

__all__ = ["LiverModel"]

LINEAR_ERROR = ((0.37, 0.05), (0.57, 0.1))
"""Depth over the ball's radius, and error of the linear force there against a neo-Hookean force.

The values hold on a block, a procedural and a scanned liver (0.36-0.39, 0.56-0.585): `python
tests/bench/chart_liver.py`.
"""
LOOK_EVERY = 20
"""Ticks between two searches for nodes whose compliance will be needed."""
LOOK_M = 5e-3
"""Distance around the tool within which these nodes are searched [m]."""


class LiverModel:
    """Soft organ under a probe.

    Parameters
    ----------
    contact
        The probe on the organ's touchable surface.
    space, touchable
        The organ's nodes and cells, and the touchable nodes of the contact, shape (t,).
    fields
        Fields of the whole organ.
    prony
        Relaxation of every modulus; None for an elastic organ. The contact's compliance is the
        instantaneous one.
    lazy
        Object that fills the contact's compliance while the tool moves; None where it is complete.
    law
        Offset of a hyperelastic organ from the contact's compliance; None for a linear organ. It
        cannot be combined with `prony`.
    ball_radius_m
        Radius of the ball that presses [m]; the depth at which linear elasticity is no longer
        enough is known for a ball only.
    step_s
        Length of a tick [s].
    """

    measure_names: tuple[str, ...] = ("indentation_mm", "contact_points", "sweeps")

    def __init__(
        self,
        contact: SurfaceContact,
        *,
        space: Space,
        touchable: Ints,
        fields: OrganFields,
        prony: Prony | None = None,
        lazy: LazyCompliance | None = None,
        law: LawOffset | None = None,
        ball_radius_m: float | None = None,
        step_s: float = TICK_S,
    ) -> None:
        self.contact = contact
        self._fields = fields
        self._lazy = lazy
        self._law = law
        self._step_s = step_s
        self.layer_names = space.mesh.part_names
        parts = np.zeros(len(self.layer_names))
        np.add.at(parts, space.mesh.part, space.mesh.volumes_m3)
        self.start_m3 = parts
        self.removed_m3 = np.zeros(len(parts))
        self.notices: list[str] = []
        self._response = Response.empty(len(self.layer_names), len(self.measure_names))
        self._layer = int(np.bincount(_parts_at(space, touchable)).argmax())
        self._touched_m = np.full(3, np.nan)
        self._unsettled = False
        self._ticks = 0
        radius_m = ball_radius_m if law is None else None
        self._limits = (
            [(depth * radius_m, error) for depth, error in LINEAR_ERROR] if radius_m else []
        )
        self._crept_N = np.zeros((len(touchable), 3))
        self._creep: HereditaryIntegral | None = None
        if prony is not None:
            self._creep, self._forces = (
                HereditaryIntegral(prony.retardation, self._crept_N.shape, step_s=step_s)
                for _ in range(2)
            )
            contact.scale_compliance(self._creep.instant_factor)

    @property
    def fields(self) -> FieldSeries:
        """Displacement, strain, stress and reaction; computed after the end of the run."""
        return self._fields.series

    def place(self, motion: ToolMotion) -> None:
        """Put the probe at its start, outside the organ."""
        self.contact.place(motion.tip_m, motion.rotation)
        if self._lazy is not None:
            self._search_contacts(motion)
            self._lazy.fill()
            while self._lazy.pour(self.contact.result.compliance_m_N):
                pass
            self._lazy.start()

    def advance(self, motion: ToolMotion) -> None:
        """Move the probe to its new pose: press, slide or lift off."""
        if self._lazy is not None:
            self._lazy.pour(self.contact.result.compliance_m_N)
            if self._ticks % LOOK_EVERY == 0:
                self._search_contacts(motion)
        self._ticks += 1
        if self._creep is not None:
            self.contact.shift(self._creep.history)
        if self._law is not None:
            self.contact.shift(
                self._law.offset_m(self._ticks * self._step_s, self._depth_m(motion))
            )
        result = self.contact.solve(motion.tip_m, motion.rotation)
        if self._creep is not None:
            np.multiply(result.nodal_forces_N, self._forces.instant_factor, out=self._crept_N)
            self._crept_N += self._forces.history
            self._forces.advance(result.nodal_forces_N)
            self._creep.advance(result.displacement_m() / self._creep.instant_factor)
        if result.outcome is not ContactOutcome.CONVERGED and not self._unsettled:
            self._unsettled = True
            self.notices.append(f"the contact did not settle: {result.outcome.value}")

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
                f"pressed {1e3 * depth:.1f} mm deep: from here linear elasticity is more "
                f"than {error:.0%} off a "
                "hyperelastic force"
            )
        measures[1] = result.contacts
        measures[2] = result.iterations
        return response

    def wait_for_background(self, time_s: float) -> None:
        """Solve a hyperelastic law where a solve is due."""
        if self._law is not None:
            depth_m = 1e-3 * float(self._response.measures[0])
            self._law.renew(time_s, depth_m, self.contact)
            self.notices += self._law.notices
            self._law.notices.clear()

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Store the forces where a frame is due."""
        if time_s >= self._fields.next_s - 1e-9:
            force = self.contact.result.nodal_forces_N
            moved = self._crept_N if self._creep is not None else force
            self._fields.keep(time_s, force, moved if self._law is None else self.displacement_m())

    def finish(self) -> None:
        """Compute the fields of the frames."""
        if self._lazy is not None:
            self._lazy.stop()
        self._fields.compute()
        self.notices += self._fields.notices
        self._fields.notices.clear()

    def summary(self) -> dict[str, object]:
        """Return the figures of a hyperelastic law for the run's summary.

        They are empty for a linear organ.
        """
        if self._law is None:
            return {}
        return {
            "law": {
                "solves": self._law.solves,
                "not_reached": self._law.unsettled,
                "indefinite_tangents": self._law.indefinite,
            }
        }

    @property
    def law_note(self) -> str:
        """Description of how the law is followed; empty for a linear organ."""
        return "" if self._law is None else self._law.note

    def displacement_m(self) -> Array:
        """Return the displacement of the touchable nodes in the last tick [m], shape (t, 3).

        It is NaN where it is not known.
        """
        moved = self.contact.result.displacement_m()
        if self._law is not None:
            return moved + self._law.latest_m
        return moved if self._creep is None else moved + self._creep.history

    def _depth_m(self, motion: ToolMotion) -> float:
        """Return the tool's travel along its axis since it last touched [m]; 0 without contact."""
        if np.isnan(self._touched_m[0]):
            return 0.0
        return float((self._touched_m - motion.tip_m) @ motion.rotation[:, 2])

    def _search_contacts(self, motion: ToolMotion) -> None:
        """Request the compliance of the nodes around the tool."""
        assert self._lazy is not None
        self._lazy.want(self.contact.nodes_in_reach(motion.tip_m, motion.rotation, LOOK_M))


def _parts_at(space: Space, nodes: Ints) -> Ints:
    """Return the part of a cell at each node, shape (t,)."""
    part = np.zeros(space.node_count, dtype=np.int64)
    part[space.cell_nodes] = space.mesh.part[:, None]
    return part[nodes]
