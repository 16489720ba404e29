"""A needle's insertion along its axis: deflection, puncture, cutting, sliding and sticking."""

from math import inf

from tissue.models.needle.parameters import NeedleTissue, positive_root

__all__ = ["Insertion"]


class Insertion:
    """One track of a needle, in one dimension.

    With z the travel of the tip beyond the undeformed surface, u the deflection of the organ and L
    the inserted length of the needle, z = u + L. Only the needle carries the organ, so the organ's
    pull equals the needle's force::

        a1 u + a2 u|u|  =  tip + hold + friction

    The tip cuts with a constant force, only deeper than it has been. The edges of the holes in the
    membranes cling with a constant force. Friction increases with L. While the pull is smaller than
    these, needle and organ move together. The shaft sticks and L stays. The pull is then the
    applied force that Karnopp's law compares with the static friction. Beyond it the shaft slides,
    u follows from the balance in closed form, and L from z. An intact membrane stops the tip until
    the pull exceeds its puncture force too. Then the organ springs back along the shaft at once, to
    the u of the remaining balance. Before the puncture the force is therefore Okamura's polynomial.
    After it the deflection, its elastic force and the inserted length are all larger than zero.

    A shaft sticks when its motion stops or reverses, when its speed falls below half the band of
    speeds that counts as rest, or when an obstacle stops the tip. Viscous friction acts on the
    needle but does not deflect the organ. The state therefore depends on the path of the needle,
    not on the number of steps of the path. The tissue is punctured, cut and rubbed, never healed.
    The work of all three is lost. Only the elastic energy of the organ is recovered.

    Not modelled: relaxation at rest, mass of the organ, force across the axis, bending, and
    stiffness that changes with depth. The organ moves as one piece with its surface, and so does an
    inner membrane: it has a puncture force but no stiffness of its own. Behind it the tissue is
    parenchyma again. The polynomial was fitted to deflections of up to 17 mm inwards. The response
    to outward deflection is assumed to be equal.

    Attributes
    ----------
    travel_m, inserted_m, deflection_m
        z, L and u [m].
    cut_m
        Largest inserted length so far [m]: the part of the track that needs no cutting.
    punctured
        Number of broken membranes, from the surface downwards.
    sliding
        1 while the shaft slides in, -1 while it slides out, 0 while it sticks or creeps.
    punctures
        Travel [m] and force [N] of every puncture, without its viscous part.
    """

    def __init__(self, tissue: NeedleTissue, *, travel_m: float = 0.0) -> None:
        self.tissue = tissue
        self.travel_m = travel_m
        self.inserted_m = 0.0
        self.deflection_m = 0.0
        self.cut_m = 0.0
        self.punctured = 0
        self.sliding = 0
        self.punctures: list[tuple[float, float]] = []
        self._depths = tuple(membrane.depth_m for membrane in tissue.membranes)
        self._holds = tuple(membrane.hold_N for membrane in tissue.membranes)

    def advance(self, travel_m: float, speed_m_s: float) -> None:
        """Move the tip to a travel at a speed; the sign of the speed has no effect."""
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
        """Force of the organ on the needle at any speed, positive against insertion [N]."""
        return self.tissue.pull_N(self.deflection_m)

    @property
    def drag_N_s_m(self) -> float:
        """Viscous friction per speed while the shaft slides [N s/m], not negative."""
        friction = self.tissue.friction
        if self.sliding == 0:
            return 0.0
        return self.inserted_m * (
            friction.viscous_in_N_s_m2 if self.sliding > 0 else friction.viscous_out_N_s_m2
        )

    def shares_N(self) -> tuple[float, float, float]:
        """Return the elastic, cutting and friction part of the pull [N]; they add up to the pull.

        While the shaft slides, these parts are the holding force of the membranes, the cutting
        force of the tip and the friction of the shaft. While it sticks, only the pull is known. Up
        to the sliding force it is divided in equal proportion to the sliding case. The excess is
        reported as elastic before an intact membrane and as friction elsewhere.
        """
        pull = self.pull_N
        length = self.inserted_m
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

        A hole right at the tip resists only inward motion.
        """
        length = self.inserted_m
        held = 0.0
        for depth, hold in zip(self._depths[: self.punctured], self._holds, strict=False):
            if depth < length or (inwards and depth == length):
                held += hold
        return held

    def _push(self, quick: bool) -> None:
        """Slide in while the pull exceeds the resistance, from one stop to the next."""
        tissue = self.tissue
        friction = self.tissue.friction
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
                self.punctures.append((self.inserted_m + tissue.deflection_m(limit), limit))
                self.punctured += 1
                continue
            self.sliding = max(self.sliding, int(quick))
            per_length = friction.sliding_in_N_m if self.sliding > 0 else friction.static_in_N_m
            resists = tip + self._hold_N(inwards=True) + per_length * self.travel_m
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

    def _next_stop_m(self) -> float:
        """Return the inserted length [m] of the next rise of resistance: track end or membrane."""
        deeper = [depth for depth in self._depths if depth > self.inserted_m]
        if self.cut_m > self.inserted_m:
            deeper.append(self.cut_m)
        return min(deeper, default=inf)

    def _draw(self, quick: bool) -> None:
        """Slide out while the organ, dragged along, pulls back with more than the holding force."""
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
