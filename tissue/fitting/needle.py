"""Force of a needle along a log, for given constants of the tissue that it goes through.

The engine's own law (`tissue.models.needle.insertion.Insertion`) runs along the log's travel; its derivatives follow in
closed form from which part of the law held at each sample.

A membrane that breaks, and a shaft that breaks away from rest, make the force jump at a travel that depends on the
constants: a likelihood would have steps there. The log shows these moments itself. They are found in it and imposed,
so that the loads are smooth in the constants. What the membrane or the static friction held at that moment is then what
the sensor read just before: over the last millimetres of travel the load passes from the law's curve to that limit
(`ANCHOR_M`). For constants that agree with the log, whose curve reaches the limit exactly there, nothing is changed.
A puncture or a breaking away that the log does not show leaves its constant at what is known before; samples around the
latter are not to be used.

A tip that is drawn out of a membrane's hole makes a jump too, at a travel that depends on the constants and is not
imposed: `unusable` names the samples from 5 mm before it on, and those around the other jumps that clocks which differ
would smear.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.needle_events import Event, near_events, speed_corners
from tissue.fitting.needle_track import CREPT_IN, CREPT_OUT, SLID_IN, SLID_OUT, NeedleTrack, followed, slid_in
from tissue.fitting.needle_walls import Wall
from tissue.fitting.parameter import Parameter
from tissue.models.needle.parameters import GREATEST_N, GREATEST_N_M, Membrane, NeedleTissue, ShaftFriction

__all__ = ["CHANNEL", "NeedleForward", "needle_names"]

CHANNEL = "force_axis_N"
"""Force on the needle along its axis, positive against insertion."""
ANCHOR_M = 3e-3
"""Travel before a jump over which the reading gives the limit that was reached [m]."""
LEAVING_M = 5e-3
"""Length of needle beyond a hole from which its leaving it is uncertain [m]: the scatter of 25 % of a deflection."""
N_MM, N_MM2 = 1e3, 1e6
LIVER = (
    "linear_N_mm", "quadratic_N_mm2", "capsule_puncture_N", "capsule_hold_N", "cutting_N", "sliding_in_N_m",
    "sliding_out_N_m", "viscous_in_N_s_m2", "viscous_out_N_s_m2", "static_in_N_m", "static_out_N_m",
)  # fmt: skip
A1, A2, _, _, CUTTING, IN, OUT, DRAG_IN, DRAG_OUT, STATIC_IN, STATIC_OUT = range(11)
CAPSULE = (2, 3)


def needle_names(walls: Sequence[Wall] = ()) -> tuple[str, ...]:
    """Constants of a needle's force that a log may determine."""
    return tuple(dict.fromkeys(_places(walls)))


def _places(walls: Sequence[Wall]) -> tuple[str, ...]:
    """Names of all constants of the law by their places, those of the membranes last, shape (11 + 2 m,)."""
    return (
        *(f"needle.liver.{name}" for name in LIVER),
        *(name for each in walls for name in (each.puncture, each.hold)),
    )


def _membranes(count: int) -> tuple[tuple[int, int], ...]:
    """Places of the puncture force and the hold of the capsule and every membrane, of so many constants."""
    return (CAPSULE, *((at, at + 1) for at in range(len(LIVER), count, 2)))


@dataclass(frozen=True, eq=False)
class NeedleForward:
    """Force on a needle along a log; a `Forward`.

    Attributes
    ----------
    parameters
        The free constants, of those that `needle_names` lists.
    known
        Values of all of them, in the units of their names, used where one is not free.
    times_s
        Shape (n,).
    travel_m
        Of the tip beyond the undeformed surface, along the axis, shape (n,); it starts outside and is smooth to within
        a sample's motion, since a shaft that turns round sticks.
    walls
        Membranes under the capsule, from the surface downwards. Forces of one name are one constant.
    stick_band_m_s
        Speeds that count as rest.
    events
        Jumps of the log, from `events_of`; () for a log without any.
    channels
        The force along the axis.
    """

    parameters: tuple[Parameter, ...]
    known: dict[str, float]
    times_s: Array
    travel_m: Array
    walls: tuple[Wall, ...] = ()
    stick_band_m_s: float = 1e-4
    events: tuple[Event, ...] = ()
    channels: tuple[str, ...] = (CHANNEL,)
    _last: dict[tuple[float, ...], tuple[Array, NeedleTrack]] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.travel_m[0] <= 0.0:
            raise InputError(
                f"travel_m must start outside the organ, at 0 or less, got {self.travel_m[0]:g}: give the log from "
                "before the needle touches"
            )
        unknown = [each.name for each in self.parameters if each.name not in self.names]
        if unknown:
            raise InputError(
                f"free must name constants of a needle, got {', '.join(unknown)}: choose of {', '.join(self.names)}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """All constants, the free ones among them."""
        return needle_names(self.walls)

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Of the membranes, from the surface downwards."""
        return (0.0, *(each.depth_m for each in self.walls))

    def expected_events(self) -> tuple[Event, ...]:
        """Jumps of the law itself along the travel, with the known constants, after those that are imposed."""
        first = max((event.sample + 1 for event in self.events), default=0)
        tissue = self._tissue(self._values([]))
        return followed(tissue, self.travel_m, self._speed_m_s, self.events, free_from=first).events

    def inserted_m(self, x: Array) -> Array:
        """Length of needle in the organ for constants x, shape (n,)."""
        return self._followed(tuple(np.asarray(x, dtype=float).tolist()))[1].inserted_m

    def unusable(self, wanted_s: Array, within_s: float) -> NDArray[np.bool_]:
        """Samples to leave out of a fit, shape of `wanted_s`.

        Those within a time [s] of where a jump may be or of a corner of the speed, and those in which a needle that is
        drawn out may leave a membrane's hole: from `LEAVING_M` before the law does so with the known constants.
        """
        track = followed(self._tissue(self._values([])), self.travel_m, self._speed_m_s, self.events)
        over = np.min([np.where(track.inserted_m >= d, track.inserted_m - d, np.inf) for d in self.depths_m], axis=0)
        outwards = np.minimum.accumulate(np.where(self._speed_m_s < 0.0, over, np.inf)) < LEAVING_M
        at = np.clip(np.searchsorted(self.times_s, wanted_s), 0, len(self.times_s) - 1)
        out: NDArray[np.bool_] = near_events(self.times_s, wanted_s, self.events, within_s) | outwards[at]
        for corner in self.times_s[speed_corners(self._speed_m_s)]:
            out |= np.abs(wanted_s - corner) <= within_s
        return out

    def loads(self, x: Array) -> Array:
        """See `Forward`."""
        values, track = self._followed(tuple(np.asarray(x, dtype=float).tolist()))
        force, _ = self._force(values, track)
        return force[:, None]

    def jacobian(self, x: Array) -> Array:
        """See `Forward`."""
        values, track = self._followed(tuple(np.asarray(x, dtype=float).tolist()))
        slopes = self._force(values, track)[1] * self._units
        return (slopes @ self._shares)[:, None, :]

    def _followed(self, x: tuple[float, ...]) -> tuple[Array, NeedleTrack]:
        """Constants and the law along the log; the last are kept, since a search asks for loads and slopes of one x."""
        if x not in self._last:
            values = self._values(list(x))
            self._last.clear()
            self._last[x] = values, followed(self._tissue(values), self.travel_m, self._speed_m_s, self.events)
        return self._last[x]

    @cached_property
    def _units(self) -> Array:
        """SI units in those of the names, by place."""
        return np.array([N_MM, N_MM2, *[1.0] * (len(_places(self.walls)) - 2)])

    @cached_property
    def _shares(self) -> Array:
        """1 where a place holds a free constant, shape (11 + 2 m, p)."""
        free = [each.name for each in self.parameters]
        return np.array([[float(name == each) for each in free] for name in _places(self.walls)])

    @cached_property
    def _speed_m_s(self) -> Array:
        return np.gradient(self.travel_m, self.times_s)

    def _values(self, x: list[float]) -> Array:
        """All constants by their places in SI units, shape (11 + 2 m,)."""
        stated = dict(self.known) | {each.name: value for each, value in zip(self.parameters, x, strict=False)}
        return np.array([stated[name] for name in _places(self.walls)]) * self._units

    def _tissue(self, values: Array) -> NeedleTissue:
        # A search may ask for what no needle meets: it gets the most that the law takes.
        v = np.minimum(values, 0.5 * GREATEST_N).tolist()
        v[A2] = min(float(values[A2]), GREATEST_N_M)
        membranes = tuple(
            Membrane(name=f"membrane {number}", depth_m=depth, puncture_N=v[puncture], hold_N=v[hold])
            for number, (depth, (puncture, hold)) in enumerate(zip(self.depths_m, _membranes(len(v)), strict=True))
        )
        friction = ShaftFriction(
            sliding_in_N_m=v[IN], sliding_out_N_m=v[OUT], viscous_in_N_s_m2=v[DRAG_IN], viscous_out_N_s_m2=v[DRAG_OUT],
            static_in_N_m=max(v[STATIC_IN], v[IN]), static_out_N_m=max(v[STATIC_OUT], v[OUT]),
            stick_band_m_s=self.stick_band_m_s,
        )  # fmt: skip
        # A search may ask for an organ softer than friction allows: it gets the softest that the law knows.
        stiff = max(v[A1], 1.05 * max(friction.static_in_N_m, friction.static_out_N_m))
        return NeedleTissue(
            linear_N_m=stiff, quadratic_N_m2=v[A2], cutting_N=v[CUTTING], friction=friction, membranes=membranes
        )

    def _force(self, v: Array, track: NeedleTrack) -> tuple[Array, Array]:
        """Force along the axis [N], shape (n,), and its derivatives by all constants in SI units, (n, 11 + 2 m)."""
        slid = self._slid(v, track)
        by_length = np.where(track.source[:, None] >= 0, slid[track.source], 0.0)
        u, length = track.deflection_m, track.inserted_m
        force = (v[A1] + v[A2] * np.abs(u)) * u
        slopes = -(v[A1] + 2.0 * v[A2] * np.abs(u))[:, None] * by_length
        slopes[:, A1] += u
        slopes[:, A2] += u * np.abs(u)
        share, by_share = slid_in(track, by_length)
        outwards = np.where(track.sliding < 0, 1.0, 0.0)
        for name, slides, by_slides in ((DRAG_IN, share, by_share), (DRAG_OUT, outwards, np.zeros_like(slopes))):
            speed = slides * self._speed_m_s
            force += v[name] * length * speed
            slopes += v[name] * (speed[:, None] * by_length + (length * self._speed_m_s)[:, None] * by_slides)
            slopes[:, name] += length * speed
        for event in (each for each in self.events if each.seen):
            share, gap, by_gap = self._anchor(v, track, by_length[event.sample], event)
            force += share * gap
            slopes += share[:, None] * by_gap
        return force, slopes

    def _slid(self, v: Array, track: NeedleTrack) -> Array:
        """Derivatives of the inserted length where the shaft slid or crept, shape (n, 11 + 2 m)."""
        u, z, n = np.abs(track.deflection_m), self.travel_m, len(self.travel_m)
        slopes = np.zeros((n, len(v)))
        for how, name, inwards in (
            (SLID_IN, IN, 1.0), (CREPT_IN, STATIC_IN, 1.0), (SLID_OUT, OUT, -1.0), (CREPT_OUT, STATIC_OUT, -1.0),
        ):  # fmt: skip
            here = track.how == how
            by = np.zeros((int(here.sum()), len(v)))
            if inwards > 0.0:
                by[:, CUTTING] = track.cuts[here]
            for number, (_, hold) in enumerate(_membranes(len(v))):
                by[:, hold] = track.holes[here] > number
            by[:, name] = z[here] - inwards * u[here]
            by[:, A1] -= u[here]
            by[:, A2] -= u[here] ** 2
            per_length = v[name] if name in (IN, OUT) else max(v[name], v[name - 4])
            slopes[here] = -inwards * by / (2.0 * v[A2] * u[here] + v[A1] + inwards * per_length)[:, None]
        return slopes

    def _anchor(self, v: Array, track: NeedleTrack, by_length: Array, event: Event) -> tuple[Array, float, Array]:
        """Share of each sample in a gap, the limit that held at an event less the law's pull there [N], its slopes."""
        k, z = event.sample, self.travel_m
        at = float(np.interp(event.at_s(self.times_s), self.times_s, z))
        length = track.inserted_m[k]
        u = at - length
        before = np.arange(len(z)) <= k
        begun = np.flatnonzero((np.abs(z - at) > ANCHOR_M) & before)
        first = int(begun[-1]) + 1 if len(begun) else 0
        share = np.where(before & (np.arange(len(z)) >= first), 1.0 - np.abs(z - at) / ANCHOR_M, 0.0)
        by = np.zeros(len(v))
        for number, (_, hold) in enumerate(_membranes(len(v))):
            by[hold] = track.holes[k] > number
        if event.kind == "puncture":
            broken = sum(each.kind == "puncture" and each.sample < k for each in self.events)
            by[_membranes(len(v))[broken][0]] = 1.0
        elif event.kind == "slip_in":
            by[CUTTING] = track.cuts[k]
        sign, name = (-1.0, STATIC_OUT) if event.kind == "slip_out" else (1.0, STATIC_IN)
        name = max(name, name - 4, key=lambda each: float(v[each]))
        by[name] = length
        limit = sign * float(by @ v)
        gap = limit - float((v[A1] + v[A2] * abs(u)) * u)
        by = sign * by + (sign * v[name] + v[A1] + 2.0 * v[A2] * abs(u)) * by_length
        by[A1] -= u
        by[A2] -= u * abs(u)
        return np.clip(share, 0.0, 1.0), gap, by
