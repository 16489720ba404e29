"""Tissue model of an organ into which a needle is inserted along its axis."""

from math import asin, degrees, inf, isfinite, pi

import numpy as np

from meshes.base.errors import InputError, in_brackets, require_positive
from tissue.fem.fields import FieldSeries
from tissue.models.needle.fields import NeedleFields
from tissue.models.needle.parameters import LEAST_COSINE, NeedleTissue, positive_root
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import Response, ToolMotion

ASIDE_M = 5e-3
"""Sideways motion of a needle inside the organ that causes an event [m]; no force depends on it."""


class Insertion:
    """One-dimensional model of a needle in one track.

    Let z be the travel of the tip beyond the undeformed surface, u the deflection of the organ and
    L the inserted length of the needle. Then z = u + L. Only the needle acts on the organ, so the
    pull of the organ equals the force of the needle::

        a1 u + a2 u|u|  =  tip + hold + friction

    Here a1 and a2 are the coefficients of the organ's elastic force. ``tip`` is the cutting force,
    which is constant and acts only where the tip goes deeper than before. ``hold`` is the constant
    force with which the holes in the membranes hold the shaft. ``friction`` is the dry friction of
    the shaft, which increases with L. Viscous friction is not included. While the pull is smaller
    than the sum on the right side, needle and organ move together: the shaft sticks and L is
    constant. In Karnopp's friction law, the pull takes the place of the applied force. The shaft
    slides if the pull exceeds the right side, computed with the static friction. Then the balance
    gives u in closed form, and L = z - u. An intact membrane stops the tip until the pull also
    exceeds the puncture force. Then the organ springs back along the shaft at once, to the
    deflection u of the new balance. Before the puncture of the capsule, L is 0, so the force is the
    polynomial of Okamura (2004) in u = z. After the puncture the deflection, the elastic force and
    the inserted length are larger than zero.

    A shaft sticks when its motion stops or reverses, or when an obstacle stops the tip. It also
    sticks when its speed falls below half of `ShaftFriction.stick_band_m_s`. Viscous friction acts
    on the needle but does not deflect the organ. The state therefore depends only on the path of
    the needle, and not on the number of steps along the path. The tissue does not heal. The work of
    puncture, cutting and friction is lost. Only the elastic energy of the organ is recovered.

    Relaxation at rest, the mass of the organ, forces across the axis, bending, and a stiffness that
    changes with depth are not modelled. The organ moves as one piece with its surface. An inner
    membrane moves with the organ: it has a puncture force but no stiffness of its own. The tissue
    behind a membrane equals the tissue in front of it. The polynomial a1 u + a2 u|u| was fitted to
    inward deflections of up to 17 mm. For outward deflections, the same coefficients are assumed.

    Parameters
    ----------
    tissue
        Tissue along the track.
    travel_m
        Travel at the start [m].
    cosine
        Cosine of the angle between the track and the surface normal. An oblique track reaches a
        membrane at the inserted length depth / cosine.

    Attributes
    ----------
    travel_m, inserted_m, deflection_m
        Travel z, inserted length L and deflection u [m].
    cut_m
        Largest inserted length so far [m]: the part of the track that is already cut.
    punctured
        Number of broken membranes, from the surface downwards.
    sliding
        1 while the shaft slides inwards, -1 while the shaft slides outwards, 0 while the shaft
        sticks or creeps.
    punctures
        Travel [m] and force [N] at every puncture; the force does not include viscous friction.
    """

    def __init__(self, tissue: NeedleTissue, *, travel_m: float = 0.0, cosine: float = 1.0) -> None:
        self.tissue = tissue
        self.travel_m = travel_m
        self.inserted_m = 0.0
        self.deflection_m = 0.0
        self.cut_m = 0.0
        self.punctured = 0
        self.sliding = 0
        self.punctures: list[tuple[float, float]] = []
        self._depths = tuple(membrane.depth_m / cosine for membrane in tissue.membranes)
        self._holds = tuple(membrane.hold_N for membrane in tissue.membranes)

    def advance(self, travel_m: float, speed_m_s: float) -> None:
        """Move the tip to the travel z at a speed. Only the magnitude of the speed matters."""
        moved = travel_m - self.travel_m
        self.travel_m = travel_m
        quick = abs(speed_m_s) >= 0.5 * self.tissue.friction.stick_band_m_s
        if not quick or moved * self.sliding <= 0.0:
            self.sliding = 0
        if self.inserted_m == 0.0 and travel_m <= 0.0:
            self.deflection_m = 0.0
        elif moved >= 0.0:
            self._push(quick)
        else:
            self._draw(quick)

    @property
    def blocked(self) -> bool:
        """True if an intact membrane stops the tip."""
        return (
            self.punctured < len(self._depths) and self._depths[self.punctured] == self.inserted_m
        )

    @property
    def pull_N(self) -> float:
        """Force on the needle without viscous friction, positive against insertion [N]."""
        return self.tissue.pull_N(self.deflection_m)

    @property
    def drag_N_s_m(self) -> float:
        """Viscous friction divided by the speed while the shaft slides [N s/m], not negative."""
        friction = self.tissue.friction
        if self.sliding == 0:
            return 0.0
        return self.inserted_m * (
            friction.viscous_in_N_s_m2 if self.sliding > 0 else friction.viscous_out_N_s_m2
        )

    def shares_N(self) -> tuple[float, float, float]:
        """Return the elastic, cutting and friction parts of the pull [N]; their sum is the pull.

        While the shaft slides, the parts are the holding force of the membranes, the cutting force
        of the tip and the friction of the shaft. While the shaft sticks, only the pull is known.
        The sliding force is the pull at which the shaft starts to slide. If the pull is at most the
        sliding force, its parts have the same proportions as during sliding. If the pull is larger,
        the excess counts as elastic if an intact membrane stops the tip, and otherwise as friction.
        """
        pull = self.pull_N
        length = self.inserted_m
        # There is no cut and no friction yet: the surface holds the tip.
        if length == 0.0 and (self.blocked or self._depths[:1] == (0.0,)):
            return pull, 0.0, 0.0
        friction = self.tissue.friction
        if pull >= 0.0:
            hold = self._hold_N(inwards=True)
            cutting = self.tissue.cutting_N if length == self.cut_m else 0.0
            rubbing = friction.sliding_in_N_m * length
        else:
            hold = self._hold_N(inwards=False)
            cutting = 0.0
            rubbing = friction.sliding_out_N_m * length
        sliding = hold + cutting + rubbing
        share = min(abs(pull) / sliding, 1.0) if sliding > 0.0 else 0.0
        if pull < 0.0:
            share = -share
        elastic = share * hold
        cutting = max(share, 0.0) * cutting
        rubbing = share * rubbing
        rest = pull - elastic - cutting - rubbing
        return (
            (elastic + rest, cutting, rubbing)
            if self.blocked
            else (elastic, cutting, rubbing + rest)
        )

    def _hold_N(self, *, inwards: bool) -> float:
        """Return the holding force of the holes around the shaft [N].

        A hole at the depth of the tip resists only inward motion.
        """
        length = self.inserted_m
        held = 0.0
        for depth, hold in zip(self._depths[: self.punctured], self._holds, strict=False):
            if depth < length or (inwards and depth == length):
                held += hold
        return held

    def _push(self, quick: bool) -> None:
        """Slide inwards while the pull exceeds the resistance.

        The motion is computed in parts. Each part ends at a depth at which the resistance rises.
        """
        tissue = self.tissue
        friction = self.tissue.friction
        reached_m = -inf  # travel at which the tip reached the current membrane in this tick
        while True:
            per_length = friction.sliding_in_N_m if self.sliding > 0 else friction.static_in_N_m
            tip = tissue.cutting_N if self.inserted_m == self.cut_m else 0.0
            if self.blocked:
                tip = tissue.membranes[self.punctured].puncture_N
            limit = tip + self._hold_N(inwards=True) + per_length * self.inserted_m
            if tissue.pull_N(self.travel_m - self.inserted_m) <= limit:
                self.deflection_m = self.travel_m - self.inserted_m
                return
            if self.blocked:
                at_m = self.inserted_m + tissue.deflection_m(limit)
                force_N = limit
                # The pull at arrival already exceeds the limit: the membrane breaks at once.
                if at_m < reached_m:
                    at_m = reached_m
                    force_N = tissue.pull_N(at_m - self.inserted_m)
                self.punctures.append((at_m, force_N))
                self.punctured += 1
                reached_m = at_m
                continue
            # A slow shaft creeps under the static friction and does not slide.
            self.sliding = max(self.sliding, int(quick))
            per_length = friction.sliding_in_N_m if self.sliding > 0 else friction.static_in_N_m
            hold = self._hold_N(inwards=True)
            resists = tip + hold + per_length * self.travel_m
            deflection = positive_root(
                tissue.quadratic_N_m2, tissue.linear_N_m + per_length, resists
            )
            stop = self._next_stop_m()
            length = max(self.travel_m - deflection, self.inserted_m)
            self.inserted_m = min(length, stop)
            self.cut_m = max(self.cut_m, self.inserted_m)
            if length < stop:
                self.deflection_m = self.travel_m - length
                return
            self.sliding = 0
            balance_m = stop + tissue.deflection_m(tip + hold + per_length * stop)
            reached_m = max(reached_m, balance_m)

    def _next_stop_m(self) -> float:
        """Return the inserted length [m] at the next rise of the resistance.

        The resistance rises at a membrane, and at the end of the part of the track that is already
        cut.
        """
        deeper = [depth for depth in self._depths if depth > self.inserted_m]
        if self.cut_m > self.inserted_m:
            deeper.append(self.cut_m)
        return min(deeper, default=inf)

    def _draw(self, quick: bool) -> None:
        """Slide outwards while the organ pulls more than the membranes and the friction hold."""
        tissue = self.tissue
        friction = self.tissue.friction
        while self.inserted_m > 0.0:
            hold = self._hold_N(inwards=False)
            per_length = friction.sliding_out_N_m if self.sliding < 0 else friction.static_out_N_m
            if tissue.pull_N(self.travel_m - self.inserted_m) >= -(
                hold + per_length * self.inserted_m
            ):
                self.deflection_m = self.travel_m - self.inserted_m
                return
            # A slow shaft creeps under the static friction and does not slide.
            self.sliding = min(self.sliding, -int(quick))
            per_length = friction.sliding_out_N_m if self.sliding < 0 else friction.static_out_N_m
            drawn = positive_root(
                tissue.quadratic_N_m2,
                tissue.linear_N_m - per_length,
                hold + per_length * self.travel_m,
            )
            stop = max((depth for depth in self._depths if depth < self.inserted_m), default=0.0)
            length = min(self.travel_m + drawn, self.inserted_m)
            self.inserted_m = max(length, stop)
            if length > stop:
                self.deflection_m = self.travel_m - length
                return
        self.sliding = 0
        self.deflection_m = max(self.travel_m, 0.0)


class NeedleModel:
    """Organ under the plane z = 0 with a needle that moves in and out along its axis.

    The force is computed by `tissue.models.needle.model.Insertion` and acts along the needle's
    axis. Sideways motion or rotation of the needle inside the organ has no resistance. An event
    reports a sideways motion of more than `ASIDE_M`. Travel and inserted length are measured along
    the axis, from its intersection with the undeformed surface. Membranes are parallel to the
    surface. The inserted lengths at which the needle reaches the membranes follow from the
    direction of the needle at its entry. A later rotation does not change these lengths. Only the
    latest track is stored. If a needle leaves the organ and enters again within one diameter of its
    last entry, it moves in the existing track. At other points the organ is treated as intact.

    The response's ``edge`` is the pull of the organ. This pull also acts at rest and does not
    depend on speed. ``resistance`` is the viscous friction of a sliding shaft. ``engaged_m2`` has
    one column for each layer. The column of the layer that the tip touches contains the
    cross-section of the needle, and the other columns contain 0. The ``measures`` are the inserted
    length [mm], the deflection of the organ [mm] and three parts of the axial force [N]: elastic,
    cutting and friction, see `Insertion.shares_N`. The sum of the parts is the axial force,
    positive against insertion.

    Parameters
    ----------
    tissue
        Tissue along the needle's axis.
    diameter_m
        Diameter of the needle [m], which determines the area of the tip. An entry farther than one
        diameter from the last entry begins a new track.
    fields
        Displacement and stress around the needle for display, or None for no display. The force
        does not depend on them.

    Raises
    ------
    InputError
        If the needle's diameter is not plausible. `place` and `advance` raise the error if the
        needle starts inside the organ, lies almost flat on the organ, or has a pose that is not
        finite.
    """

    measure_names: tuple[str, ...] = (
        "insertion_mm",
        "deflection_mm",
        "elastic_N",
        "cutting_N",
        "friction_N",
    )

    def __init__(
        self, tissue: NeedleTissue, *, diameter_m: float, fields: NeedleFields | None = None
    ) -> None:
        require_positive("diameter_m", diameter_m, "an 18 gauge needle has 1.27e-3 m")
        self.tissue = tissue
        self.insertion = Insertion(tissue)
        self._fields = fields
        self._diameter_m = diameter_m
        self._entry_m = np.full(3, np.nan)
        self._is_aside = False
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

        The fields are computed after the end of the run.
        """
        return None if self._fields is None else self._fields.series

    def place(self, motion: ToolMotion) -> None:
        """Put the needle at its first pose, outside the organ."""
        travel = self._travel_m(motion)
        if travel > 0.0:
            raise InputError(
                "motion",
                "start with the needle's tip outside the organ",
                f"a tip {1e3 * travel:g} mm inside",
                "start above the surface",
            )
        self.insertion = Insertion(self.tissue, travel_m=travel)
        self._entry_m[:] = np.nan
        self._is_aside = False

    def advance(self, motion: ToolMotion) -> None:
        """Move the needle to its new pose, and compute elastic deflection, cutting and friction."""
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
            membrane = self.tissue.membranes[punctured]
            what = (
                f"the {membrane.name} is punctured after {1e3 * at:.1f} mm of travel "
                f"with {force:.2f} N"
            )
            if membrane.depth_m > 0.0:
                what += (
                    f". It lies {1e3 * membrane.depth_m:.1f} mm deep and breaks at a tip force of "
                    f"{membrane.puncture_N:.2f} N"
                )
            self.notices.append(what)
            punctured += 1
        if insertion.inserted_m > 0.0 and not self._is_aside:
            self._notice_sideways(motion, travel)
        if inside and insertion.inserted_m == 0.0:
            self.notices.append("the needle has left the organ")

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend."""
        return copied(self, ("insertion", "_entry_m", "_is_aside"))

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        put_back(self, state)

    def respond(self, motion: ToolMotion) -> Response:
        """Return the force on the needle along its axis."""
        insertion = self.insertion
        response = self._response
        axis = motion.rotation[:, 2]
        along = float(motion.heading[0].dot(axis))
        # A path can turn within a tick in which the shaft slides. The shaft then sticks at its end.
        turned = insertion.sliding * along > 0.0
        drag = 0.0 if turned else insertion.drag_N_s_m * along
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
        """Store deflection and inserted length if a frame of the display is due."""
        # 1e-9 s: the time of a tick is rounded.
        if self._fields is not None and time_s >= self._fields.next_s - 1e-9:
            insertion = self.insertion
            self._fields.keep(
                time_s,
                deflection_m=insertion.deflection_m,
                inserted_m=insertion.inserted_m,
                entry_m=self._entry_m,
            )

    def finish(self) -> None:
        """Compute the displayed fields at all stored times, after the run."""
        if self._fields is not None:
            self._fields.compute()

    def _travel_m(self, motion: ToolMotion) -> float:
        """Return the depth of the tip beyond the surface, along the needle's axis [m].

        The depth is negative outside the organ.
        """
        below = -float(motion.tip_m[2])
        cosine = float(motion.rotation[2, 2])
        if not (isfinite(below) and isfinite(cosine)):
            raise InputError(
                "the needle's pose", "be finite", f"its tip at {motion.tip_m}", "fix the motion"
            )
        # The travel along the axis of a flatter needle is not defined. Outside the organ it is
        # measured vertically instead.
        if cosine >= LEAST_COSINE:
            return below / cosine
        if below > 0.0 or self.insertion.inserted_m > 0.0:
            if cosine < 0.0:
                axis = motion.rotation[:, 2]
                raise InputError(
                    "the needle's axis",
                    "point from tip to shank, out of the organ",
                    in_brackets(axis, ".3g"),
                    f"reverse it to {in_brackets(0.0 - axis, '.3g')}, in a scene by motion.axis",
                )
            raise InputError(
                "the needle's axis",
                "meet the surface at more than 10 degrees",
                f"{degrees(asin(cosine)):.0f} degrees",
                "point the needle into the organ",
            )
        return below

    def _touch(self, motion: ToolMotion, travel_m: float) -> Insertion:
        """Return the track at the point where the needle enters the surface.

        The result is the last track if it starts within one needle diameter of this point and the
        needle has cut it. Otherwise the result is a new track.
        """
        entry = motion.tip_m + travel_m * motion.rotation[:, 2]
        # The comparison is also true for the first entry, because the entry before it is NaN.
        is_new = not np.linalg.norm(entry - self._entry_m) <= self._diameter_m
        if is_new:
            self._entry_m[:] = entry
            self._is_aside = False
        # Where nothing is cut yet, the track has the direction of the needle.
        if is_new or self.insertion.cut_m == 0.0:
            self.insertion = Insertion(self.tissue, cosine=float(motion.rotation[2, 2]))
        return self.insertion

    def _notice_sideways(self, motion: ToolMotion, travel_m: float) -> None:
        """Add an event if the needle's axis is more than `ASIDE_M` away from its entry point."""
        axis = motion.rotation[:, 2]
        x, y = motion.tip_m[:2] + travel_m * axis[:2] - self._entry_m[:2]
        if x * x + y * y > ASIDE_M**2:
            self._is_aside = True
            self.notices.append(
                f"the needle has moved {1e3 * ASIDE_M:g} mm sideways in the organ: forces across "
                "its axis are not modelled"
            )

    def _layer(self) -> int:
        """Return the index of the layer that the tip touches."""
        insertion = self.insertion
        if insertion.blocked:
            number = insertion.punctured
            return number if number < self._parenchyma else number + 1
        return 0 if insertion.inserted_m == 0.0 else self._parenchyma
