"""Tissue model of soft tissue that a blade cuts."""

from math import asin, degrees, inf, isfinite

import numpy as np

from meshes.base.errors import InputError
from tissue.fem.fields import FieldSeries
from tissue.models.incision.cut import Cut
from tissue.models.incision.fields import IncisionFields
from tissue.models.incision.parameters import Blade, IncisedTissue
from tissue.models.needle.parameters import LEAST_COSINE
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import Response, ToolMotion

PLAY_M = 1e-3
"""Distance from a cut's plane up to which a blade in the cut feels no sideways force [m].

The value is chosen: it is about half the width of an open cut. A blade that enters the tissue
within this distance of a cut moves in this cut. With a larger value, the blade could move too far
sideways without a force. With a smaller value, a second pass by a simulated hand would start
another cut next to the first cut.
"""


class IncisionModel:
    """Tissue under the plane z = 0 that a blade cuts.

    The force in the plane of the blade is computed by `tissue.models.incision.cut.Cut`. The plane
    and the direction of the blade at its entry define the plane and the direction of the cut.
    Rotation of a blade inside the tissue is not resisted and has no effect. A blade does not cut
    sideways, across its plane. If the blade is farther than `PLAY_M` from the plane of the cut, the
    tissue pushes the blade back elastically. The stiffness of this force increases with the depth,
    up to a depth equal to the blade's width. A blade re-enters an earlier cut if it points in the
    direction of this cut and its whole width enters within `PLAY_M` of the plane of the cut.
    Elsewhere the tissue is treated as intact, even where the blade crosses an earlier cut. The
    force acts at the tip, so there is no torque about the tip.

    Relaxation, weight, blades with a blunt back, fibres and layers are not modelled.

    The force does not depend on speed. The response contains it as ``edge``. ``engaged_m2`` of the
    response is the area of the two walls that touch the blade, plus the area of the edge. The
    ``measures`` of the response are the depth of the tip in the tissue [mm], the deflection of the
    tissue [mm], the cut area [mm2] and the work of friction [mJ].

    Parameters
    ----------
    tissue, blade
        Tissue and blade.
    fields
        Fields that show how the cut opens. None if nothing is displayed. The force does not depend
        on the fields.

    Raises
    ------
    InputError
        If the blade starts inside the tissue, lies almost flat on it, or has a pose that is not
        finite.
    """

    measure_names: tuple[str, ...] = ("cut_depth_mm", "deflection_mm", "cut_mm2", "friction_mJ")

    def __init__(
        self, tissue: IncisedTissue, blade: Blade, *, fields: IncisionFields | None = None
    ) -> None:
        self.tissue = tissue
        self.blade = blade
        self.cuts: list[Cut] = []
        self._fields = fields
        self._in: Cut | None = None
        self._stiffness = tissue.stiffness_N_m
        self._held = self._stiffness * np.eye(3)
        self._free = np.zeros((3, 3))
        self.layer_names = (tissue.name,)
        self.start_m3 = np.zeros(1)
        self.removed_m3 = np.zeros(1)
        self._response = Response.empty(1, len(self.measure_names))
        self._response.normal[2] = 1.0
        self._response.surface_N_m = self._stiffness

    @property
    def fields(self) -> FieldSeries | None:
        """Displacement, strain and stress around the cut, computed after the end of the run."""
        return None if self._fields is None else self._fields.series

    @property
    def area_m2(self) -> float:
        """Area of all cuts [m2], counting the two walls of a cut once."""
        return sum(cut.area_m2 for cut in self.cuts)

    @property
    def friction_J(self) -> float:
        """Work of friction in all cuts [J]."""
        return sum(cut.friction_J for cut in self.cuts)

    def place(self, motion: ToolMotion) -> None:
        """Put the blade at its first pose, outside the tissue."""
        depth = self._below_m(motion)
        if depth > 0.0:
            raise InputError(
                "motion",
                "start with the blade outside the tissue",
                f"a blade {1e3 * depth:g} mm inside",
                "start above the surface",
            )
        self.cuts.clear()
        self._in = None

    def advance(self, motion: ToolMotion) -> None:
        """Move the blade to its new pose, and compute elastic deflection, cutting and friction."""
        below = self._below_m(motion)
        if self._in is None:
            if below <= 0.0:
                return
            self._in = self._entered(motion)
        cut = self._in
        along, depth, _ = cut.coordinates_m(motion.tip_m)
        cut.advance(along, depth)
        if cut.deepest_m(cut.place_m[1]) <= 0.0 and below <= 0.0:
            self._in = None

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend."""
        return copied(self, ("cuts", "_in"))

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        put_back(self, state)

    def respond(self, motion: ToolMotion) -> Response:
        """Return the force on the blade."""
        response = self._response
        response.engaged_m2[0] = 0.0
        # Below a blade inside a cut, the distance to uncut tissue is not computed.
        response.gap_m = max(-self._below_m(motion), 0.0) if self._in is None else inf
        response.stiffness_N_m = self._free
        response.wrench[:] = 0.0
        measures = response.measures
        measures[:2] = 0.0
        if (cut := self._in) is not None:
            along, out = cut.pull_N
            deepest = max(cut.deepest_m(cut.place_m[1]), 0.0)
            aside = cut.coordinates_m(motion.tip_m)[2]
            pushed = max(abs(aside) - PLAY_M, 0.0) * (1.0 if aside > 0.0 else -1.0)
            across = -self._stiffness * min(deepest / self.blade.width_m, 1.0) * pushed
            response.wrench[:3] = along * cut.along + out * cut.up + across * cut.across
            if along != 0.0 or out != 0.0:
                response.stiffness_N_m = self._held
                response.engaged_m2[0] = 2.0 * cut.touching_m2 + (
                    self.blade.width_m * self.blade.thickness_m
                )
            measures[0] = 1e3 * deepest
            measures[1] = 1e3 * float(np.hypot(along, out)) / self._stiffness
        response.edge[:] = response.wrench
        measures[2] = 1e6 * self.area_m2
        measures[3] = 1e3 * self.friction_J
        return response

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Store the profiles of the cuts if a frame of the display is due."""
        # 1e-9 s: the time of a tick is rounded.
        if self._fields is not None and time_s >= self._fields.next_s - 1e-9:
            self._fields.keep(time_s, self.cuts)

    def finish(self) -> None:
        """Compute the displayed fields at all stored times, after the run."""
        if self._fields is not None:
            self._fields.compute()

    def _below_m(self, motion: ToolMotion) -> float:
        """Return the depth of the lowest point of the edge [m], negative outside the tissue."""
        tip = float(motion.tip_m[2])
        edge = float(motion.rotation[2, 0] + self.blade.rise * motion.rotation[2, 2])
        if not (isfinite(tip) and isfinite(edge)):
            raise InputError(
                "the blade's pose", "be finite", f"its tip at {motion.tip_m}", "fix the motion"
            )
        return -tip - min(self.blade.width_m * edge, 0.0)

    def _entered(self, motion: ToolMotion) -> Cut:
        """Return the cut in which the blade moves after it enters: an earlier cut or a new cut."""
        # The axis lies in the blade's plane, so the plane is steep if the axis is steep.
        rise = float(motion.rotation[2, 2])
        if rise < LEAST_COSINE:
            raise InputError(
                "the blade's axis",
                "meet the surface at more than 10 degrees",
                f"{degrees(asin(max(rise, -1.0))):.0f} degrees",
                "point the blade into the tissue",
            )
        new = Cut(self.tissue, self.blade, motion.tip_m, motion.rotation)
        for cut in self.cuts:
            along, _, aside = cut.coordinates_m(new.origin_m)
            end = cut.coordinates_m(new.origin_m + self.blade.width_m * new.along)
            if max(abs(aside), abs(end[2])) <= PLAY_M and end[0] > along:
                cut.enter(along)
                return cut
        new.enter(new.coordinates_m(motion.tip_m)[0])
        self.cuts.append(new)
        return new
