"""A soft organ under a probe: contact at every tick, displacement and stress of the whole where a frame is due."""

import numpy as np
from numpy.typing import NDArray

from tissue.fem.fields import FieldSeries
from tissue.fem.solvers.lazy_compliance import LazyCompliance
from tissue.fem.space import Space
from tissue.materials.prony import HereditaryIntegral, Prony
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.contact_result import ContactOutcome
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.viscous import CreepState
from tissue.models.tissue_model import Response, ToolMotion

__all__ = ["LiverModel"]

Array = NDArray[np.float64]
LINEAR_ERROR = ((0.37, 0.05), (0.57, 0.1))
"""Depth over the ball's radius at which the linear force is off a neo-Hookean one by so much, on a block, a procedural
and a scanned liver (0.36-0.39, 0.56-0.585): `python tests/bench/chart_liver.py`."""
LOOK_EVERY = 20
"""Ticks between two looks for nodes whose compliance will be wanted."""
LOOK_M = 5e-3
"""Distance around the tool within which they are looked for [m]."""


class LiverModel:
    """A soft organ that a probe presses.

    Parameters
    ----------
    contact
        The probe on the organ's touchable surface.
    space, touchable
        The organ's nodes and cells, and the nodes that the contact knows, shape (t,).
    fields
        Fields of the whole organ.
    prony
        How every modulus relaxes; None for an elastic organ. The contact's compliance is the instantaneous one.
    lazy
        What fills the contact's compliance while the tool moves; None where it is whole.
    ball_radius_m
        Radius of a ball that presses [m], for which it is known where linear elasticity stops being enough.
    step_s
        Length of a tick [s].
    """

    measure_names: tuple[str, ...] = ("indentation_mm", "contact_points", "sweeps")

    def __init__(
        self,
        contact: SurfaceContact,
        *,
        space: Space,
        touchable: NDArray[np.int64],
        fields: OrganFields,
        prony: Prony | None = None,
        lazy: LazyCompliance | None = None,
        ball_radius_m: float | None = None,
        step_s: float = 1e-3,
    ) -> None:
        self.contact, self._fields, self._lazy = contact, fields, lazy
        self.layer_names = space.mesh.part_names
        parts = np.zeros(len(self.layer_names))
        np.add.at(parts, space.mesh.part, space.mesh.volumes_m3)
        self.start_m3, self.removed_m3 = parts, np.zeros(len(parts))
        self.notices: list[str] = []
        self._response = Response.empty(len(self.layer_names))
        self._response.measures = np.zeros(len(self.measure_names))
        self._layer = int(np.bincount(_parts_at(space, touchable)).argmax())
        self._touched_m = np.full(3, np.nan)
        self._unsettled, self._ticks = False, 0
        self._limits = [(depth * ball_radius_m, error) for depth, error in LINEAR_ERROR] if ball_radius_m else []
        self._creep = CreepState(len(touchable), prony, step_s=step_s) if prony is not None else None
        self._forces = (
            HereditaryIntegral(prony.retardation, (len(touchable), 3), step_s=step_s) if prony is not None else None
        )
        self._crept_N = np.zeros((len(touchable), 3))
        if self._creep is not None:
            contact.scale_compliance(self._creep.instant_factor)

    @property
    def fields(self) -> FieldSeries:
        """Displacement, strain, stress and reaction; computed when the run has ended."""
        return self._fields.series

    def place(self, motion: ToolMotion) -> None:
        """Put the probe where it starts, outside the organ."""
        self.contact.place(motion.tip_m, motion.rotation)
        if self._lazy is not None:
            self._search_contacts(motion)
            self._lazy.fill()
            while self._lazy.pour(self.contact.compliance_m_N):
                pass
            self._lazy.start()

    def advance(self, motion: ToolMotion) -> None:
        """Press, slide or lift off."""
        if self._lazy is not None:
            self._lazy.pour(self.contact.compliance_m_N)
            if self._ticks % LOOK_EVERY == 0:
                self._search_contacts(motion)
        self._ticks += 1
        if self._creep is not None:
            self.contact.shift(self._creep.offset_m)
        result = self.contact.solve(motion.tip_m, motion.rotation)
        if self._creep is not None and self._forces is not None:
            np.multiply(result.nodal_forces_N, self._forces.instant_factor, out=self._crept_N)
            self._crept_N += self._forces.history
            self._forces.advance(result.nodal_forces_N)
            self._creep.advance(result.displacement_m() / self._creep.instant_factor)
        if result.outcome is not ContactOutcome.CONVERGED and not self._unsettled:
            self._unsettled = True
            self.notices.append(f"the contact did not settle: {result.outcome.value}")

    def respond(self, motion: ToolMotion) -> Response:
        """Force and torque on the probe."""
        result, response = self.contact.result, self._response
        response.wrench[:3], response.wrench[3:] = result.force_N, result.torque_Nm
        response.edge[:] = response.wrench
        if result.contacts == 0:
            self._touched_m[:] = np.nan
        elif np.isnan(self._touched_m[0]):
            self._touched_m[:] = motion.tip_m
        response.engaged_m2[self._layer] = result.area_m2 if result.contacts else 0.0
        measures = response.measures
        measures[0] = 1e3 * float((self._touched_m - motion.tip_m) @ motion.rotation[:, 2]) if result.contacts else 0.0
        while self._limits and measures[0] > 1e3 * self._limits[0][0]:
            depth, error = self._limits.pop(0)
            self.notices.append(
                f"pressed {1e3 * depth:.1f} mm deep: from here linear elasticity is more than {error:.0%} off a "
                "hyperelastic force"
            )
        measures[1], measures[2] = result.contacts, result.iterations
        return response

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Keep the forces where a frame is due."""
        if time_s >= self._fields.next_s - 1e-9:
            force = self.contact.result.nodal_forces_N
            self._fields.keep(time_s, force, force if self._creep is None else self._crept_N)

    def finish(self) -> None:
        """Compute the fields of the frames."""
        if self._lazy is not None:
            self._lazy.stop()
        self._fields.compute()

    def displacement_m(self) -> Array:
        """Displacement of the touchable nodes in the last tick [m], shape (t, 3); NaN where it is not known."""
        moved = self.contact.result.displacement_m()
        return moved if self._creep is None else moved + self._creep.offset_m

    def _search_contacts(self, motion: ToolMotion) -> None:
        """Ask for the compliance of the nodes around the tool."""
        assert self._lazy is not None
        self._lazy.want(self.contact.nodes_in_reach(motion.tip_m, motion.rotation, LOOK_M))


def _parts_at(space: Space, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Part of a cell at each node, shape (t,)."""
    part = np.zeros(space.node_count, dtype=np.int64)
    part[space.cell_nodes] = space.mesh.part[:, None]
    return part[nodes]
