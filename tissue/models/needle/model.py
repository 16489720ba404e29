"""Needle in an organ, as a tissue that a tool moves through."""

from math import isfinite, pi
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError, require_positive
from tissue.fem.fields import FieldSeries
from tissue.models.needle.insertion import Insertion
from tissue.models.needle.parameters import NeedleTissue
from tissue.models.tissue_model import Response, ToolMotion

if TYPE_CHECKING:
    from tissue.models.needle.fields import NeedleFields

__all__ = ["NeedleModel"]

LEAST_COSINE = 0.17
"""Smallest cosine between the needle's axis and the surface normal.

The axis must meet the surface at more than 10 degrees, because the model has no force across the
axis.
"""


class NeedleModel:
    """Organ under the plane z = 0 with a needle that moves in and out along its axis.

    The force follows `tissue.models.needle.insertion.Insertion` and acts along the needle's axis.
    Sideways motion or rotation of the needle inside the organ has no resistance. Depths count along
    the axis, from its intersection with the undeformed surface. Only the latest track is stored. A
    needle that leaves and re-enters within a diameter of its last entry finds an open track.
    Elsewhere the organ is intact.

    The response's ``edge`` is the pull of the organ, which also acts at rest and does not depend on
    speed; ``resistance`` is the viscous friction of a sliding shaft. ``engaged_m2`` is the
    cross-section of the tip, in the layer it touches. The measures are the inserted length and the
    deflection of the organ [mm], then three parts of the axial force [N]: the holding force of
    membranes, the cutting force of the tip and the friction along the shaft. These parts add up to
    the axial force, positive against insertion.

    Parameters
    ----------
    tissue
        Tissue along the needle's axis.
    diameter_m
        Diameter of the needle [m]. It sets the area of the tip, and the distance from the last
        track at which a new track begins.
    fields
        Displacement and stress around the needle for display; the force does not depend on it. None
        shows nothing.

    Raises
    ------
    InputError
        If the needle's diameter is not plausible; later, if the needle starts inside the organ,
        lies almost flat on it, or has a pose that is not finite.
    """

    measure_names: tuple[str, ...] = (
        "insertion_mm",
        "deflection_mm",
        "elastic_N",
        "cutting_N",
        "friction_N",
    )

    def __init__(
        self,
        tissue: NeedleTissue,
        *,
        diameter_m: float,
        fields: "NeedleFields | None" = None,
    ) -> None:
        require_positive("diameter_m", diameter_m, "an 18 gauge needle has 1.27e-3 m")
        self.tissue = tissue
        self.insertion = Insertion(tissue)
        self._fields = fields
        self._diameter_m = diameter_m
        self._entry_m = np.full(3, np.nan)
        membranes = tuple(membrane.name for membrane in tissue.membranes)
        surface = sum(membrane.depth_m == 0.0 for membrane in tissue.membranes)
        self.layer_names = (*membranes[:surface], "parenchyma", *membranes[surface:])
        self._parenchyma = surface
        self.start_m3 = np.zeros(len(self.layer_names))
        self.removed_m3 = np.zeros(len(self.layer_names))
        self.notices: list[str] = []
        self._response = Response.empty(len(self.layer_names), len(self.measure_names))

    @property
    def fields(self) -> FieldSeries | None:
        """Displacement, strain, stress and reaction of a block around the needle.

        They are computed after the end of the run.
        """
        return None if self._fields is None else self._fields.series

    def place(self, motion: ToolMotion) -> None:
        """Put the needle at its start, outside the organ."""
        travel = self._travel_m(motion)
        if travel > 0.0:
            raise InputError(
                "motion",
                "start with the needle's tip outside the organ",
                f"it {1000.0 * travel:g} mm inside",
                "start above the surface",
            )
        self.insertion = Insertion(self.tissue, travel_m=travel)
        self._entry_m[:] = np.nan

    def advance(self, motion: ToolMotion) -> None:
        """Push, cut and slide to the needle's new pose."""
        travel = self._travel_m(motion)
        insertion = self.insertion
        if travel > 0.0 and insertion.travel_m <= 0.0 and insertion.inserted_m == 0.0:
            insertion = self._touch(motion, travel)
        inside = insertion.inserted_m > 0.0
        punctured = insertion.punctured
        insertion.advance(
            travel, motion.speed_m_s * float(motion.heading[0].dot(motion.rotation[:, 2]))
        )
        while punctured < insertion.punctured:
            at, force = insertion.punctures[punctured]
            name = self.tissue.membranes[punctured].name
            self.notices.append(f"the {name} is punctured at {1e3 * at:.1f} mm with {force:.2f} N")
            punctured += 1
        if inside and insertion.inserted_m == 0.0:
            self.notices.append("the needle has left the organ")

    def respond(self, motion: ToolMotion) -> Response:
        """Return the force on the needle along its axis."""
        insertion = self.insertion
        response = self._response
        axis = motion.rotation[:, 2]
        along = float(motion.heading[0].dot(axis))
        drag = insertion.drag_N_s_m * along
        pull = insertion.pull_N
        response.edge[:3] = pull * axis
        response.resistance[:3] = -drag * axis
        response.wrench[:3] = (pull - drag * motion.speed_m_s) * axis
        response.engaged_m2[:] = 0.0
        if insertion.travel_m > 0.0 or insertion.inserted_m > 0.0:
            response.engaged_m2[self._layer()] = 0.25 * pi * self._diameter_m**2
        elastic, cutting, friction = insertion.shares_N()
        measures = response.measures
        measures[0] = 1e3 * insertion.inserted_m
        measures[1] = 1e3 * insertion.deflection_m
        measures[2] = elastic
        measures[3] = cutting
        measures[4] = friction - drag * motion.speed_m_s
        return response

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Store the deflection where a frame is due."""
        if self._fields is not None and time_s >= self._fields.next_s - 1e-9:
            insertion = self.insertion
            self._fields.keep(
                time_s,
                deflection_m=insertion.deflection_m,
                inserted_m=insertion.inserted_m,
                entry_m=self._entry_m,
            )

    def finish(self) -> None:
        """Compute the fields of the frames."""
        if self._fields is not None:
            self._fields.compute()

    def _travel_m(self, motion: ToolMotion) -> float:
        """Return the depth of the tip beyond the surface, along the needle's axis [m].

        It is negative outside.
        """
        below = -float(motion.tip_m[2])
        cosine = float(motion.rotation[2, 2])
        if not (isfinite(below) and isfinite(cosine)):
            raise InputError(
                "the needle's pose", "be finite", f"its tip at {motion.tip_m}", "fix the motion"
            )
        if cosine >= LEAST_COSINE:
            return below / cosine
        if below > 0.0 or self.insertion.inserted_m > 0.0:
            raise InputError(
                "the needle's axis",
                "meet the surface at more than 10 degrees",
                f"a cosine of {cosine:.2f} to its normal",
                "point the needle into the organ",
            )
        return below

    def _touch(self, motion: ToolMotion, travel_m: float) -> Insertion:
        """Return the track at the point where the needle meets the surface.

        It is the last track if that lies there, else a new one.
        """
        entry = motion.tip_m + travel_m * motion.rotation[:, 2]
        if not float(np.linalg.norm(entry - self._entry_m)) <= self._diameter_m:
            self.insertion = Insertion(self.tissue)
            self._entry_m[:] = entry
        return self.insertion

    def _layer(self) -> int:
        """Return the layer that the tip touches."""
        insertion = self.insertion
        if insertion.blocked:
            number = insertion.punctured
            return number if number < self._parenchyma else number + 1
        return 0 if insertion.inserted_m == 0.0 else self._parenchyma
