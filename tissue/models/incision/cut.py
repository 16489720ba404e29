"""Plane cut of a straight edge: cut area, parted walls, and the balance of a blade on tissue."""

from math import floor, hypot
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from tissue.models.incision.parameters import Blade, IncisedTissue

__all__ = ["Cut"]

COLUMNS = 512
"""Number of columns across a blade that store the cut.

A column holds one mean depth, so that the area cut by a pointed blade is off by about half a
column's width over the depth, 0.2 % of a depth that equals the blade's width.
"""
CHUNK = 4 * COLUMNS
"""Number of columns by which the stored part of a cut grows."""
TOUCH_M = 1e-9
"""Distance from the bottom of the cut at which an edge touches it [m]: far above rounding."""
TRIALS = 2
"""Largest number of trials of a step; two are usual."""
SWEEPS = 20
"""Largest number of sweeps of the search for a balance, which starts from the last one."""


class _Side(NamedTuple):
    """Resistance of the tissue in front of a side of the blade.

    Attributes
    ----------
    force_N
        Force on the side while it cuts, per its travel into the tissue [N].
    gap_m
        Travel before it reaches uncut tissue [m].
    """

    force_N: float
    gap_m: float


NOTHING = (_Side(0.0, 0.0),) * 3
"""Sides of a blade that touches no uncut tissue."""


class Cut:
    """Cut in one plane, made by a blade that does not turn, and the blade's position in it.

    A point of the plane has the coordinates s along the surface and l along the blade's axis, into
    the tissue. The blade covers everything above its straight edge, so the cut is the region above
    a depth profile over s. Columns of equal width hold its mean depth, and the part of it whose walls
    still touch the blade. Walls touch from the cut on. They part as soon as the blade uncovers
    them, and then stay apart.

    Only the blade carries the tissue, as in `tissue.models.needle.model.Insertion`. With u the
    vector from the blade's position q in the tissue to the tool, in the plane of the cut, the
    tissue pulls with -k u. Every step finds the q that minimises the energy::

        k u²/2  +  J A(q)  +  2 tau M |q - q_before|

    with A the cut area and M the area of each wall that touches the blade. J is thus the energy
    release at which the blade cuts (Francfort and Marigo 1998): a side of the blade cuts where the
    force across it is J times its length in uncut tissue, and a smaller force leaves the blade
    where it is. The edge has no friction along itself. The work of the tool equals the change of
    k u²/2, plus J A, plus the work of friction. The energy is convex in q but for terms of the
    square of a step, so that q changes by no more than the tool does.

    Attributes
    ----------
    place_m
        s and l of the blade's tip in the tissue [m].
    pull_N
        Force of the tissue on the blade in the plane, along the surface and out of it [N].
    area_m2
        Area cut so far, one side [m2].
    touching_m2
        Area of each wall that touches the blade [m2].
    friction_J
        Work of friction so far [J].
    """

    def __init__(self, tissue: IncisedTissue, blade: Blade, tip_m: Array, rotation: Array) -> None:
        self._tissue = tissue
        self.axis = rotation[:, 2].copy()
        self.across = rotation[:, 1].copy()
        # The line along the surface, in the sense from the tip to the end of the edge.
        along = np.array([self.across[1], -self.across[0], 0.0])
        self.along = along / np.linalg.norm(along)
        self.up = np.cross(self.along, self.across)
        self._sine = float(self.axis @ self.along)
        self._cosine = float(self.axis @ self.up)
        self.origin_m = tip_m - tip_m[2] / self.axis[2] * self.axis
        self.width_m = blade.width_m / self._cosine
        self._slope = self._sine - self._cosine * blade.rise
        self._spacing_m = self.width_m / COLUMNS
        self._rises = self._slope * self._spacing_m * np.arange(COLUMNS + 1)
        self._first = -CHUNK
        self._cut, self._touching = np.zeros((2, 2 * CHUNK))
        self._window = 0
        # Edge, front and back: the travel of each per travel along the surface and out of it.
        lean = self._sine / self._cosine
        edge = -self._slope, self._slope * lean - 1.0 / self._cosine
        self._ways = edge, (1.0, -lean), (-1.0, lean)
        self._sides = NOTHING
        self._shares = [0.0, 0.0, 0.0]
        self.place_m = (0.0, 0.0)
        self.pull_N = (0.0, 0.0)
        self.area_m2 = 0.0
        self.touching_m2 = 0.0
        self.friction_J = 0.0

    def coordinates_m(self, tip_m: Array) -> tuple[float, float, float]:
        """Return s, l and the distance from the plane of a point [m]."""
        arm = tip_m - self.origin_m
        depth = -float(arm @ self.up) / self._cosine
        return float(arm @ self.along) + depth * self._sine, depth, float(arm @ self.across)

    def deepest_m(self, depth_m: float) -> float:
        """Return the depth of the deepest point of the edge, for a depth of the tip [m]."""
        return depth_m + max(self._slope * self.width_m, 0.0)

    def enter(self, along_m: float) -> None:
        """Put the blade onto the surface."""
        self.place_m = (along_m, -self.deepest_m(0.0))
        self.pull_N = (0.0, 0.0)
        self._sides = NOTHING

    def advance(self, along_m: float, depth_m: float) -> None:
        """Move the tool to a position, and the blade in the tissue to its balance."""
        start_s, start_l = self.place_m
        stiffness = self._tissue.stiffness_N_m
        # Stretch in orthogonal directions: along the surface and out of it.
        out = -(depth_m - start_l) * self._cosine
        across = (along_m - start_s) - (depth_m - start_l) * self._sine
        rubbing = 2.0 * self._tissue.friction_Pa * self.touching_m2
        for _ in range(TRIALS):
            moved_across, moved_out = self._moved(across, out, rubbing)
            deeper = -moved_out / self._cosine
            place = start_s + moved_across + deeper * self._sine, start_l + deeper
            self._sides = self._sides_at(*place)
        self.friction_J += rubbing * hypot(moved_across, moved_out)
        self._part(*place)
        self.pull_N = -stiffness * (across - moved_across), -stiffness * (out - moved_out)

    def profile_m(self) -> tuple[Array, Array]:
        """Return middles of the columns and mean depths of the cut in them [m]."""
        middles = (self._first + 0.5 + np.arange(len(self._cut))) * self._spacing_m
        cut = self._cut > 0.0
        return middles[cut], self._cut[cut]

    def _moved(self, across_m: float, out_m: float, rubbing_N: float) -> tuple[float, float]:
        """Return the travel through the tissue, along the surface and out of it [m].

        It minimises the energy with the resistance of the sides linear beyond their gaps. The
        unknowns are the shares, from 0 to 1, of the forces at which the sides cut.
        """
        stiffness = self._tissue.stiffness_N_m
        shares = self._shares
        pushes = list(zip(self._ways, self._sides, strict=True))
        for index, ((way_across, way_out), side) in enumerate(pushes):
            push = shares[index] * side.force_N / stiffness
            across_m -= push * way_across
            out_m -= push * way_out
        for _ in range(SWEEPS):
            largest = 0.0
            for index, ((way_across, way_out), side) in enumerate(pushes):
                if side.force_N == 0.0:
                    shares[index] = 0.0
                    continue
                excess = across_m * way_across + out_m * way_out - side.gap_m
                push = side.force_N / stiffness
                share = shares[index] + excess / (push * (way_across**2 + way_out**2))
                push *= min(max(share, 0.0), 1.0) - shares[index]
                shares[index] = min(max(share, 0.0), 1.0)
                across_m -= push * way_across
                out_m -= push * way_out
                largest = max(largest, abs(push))
            if largest <= TOUCH_M:
                break
        # Friction takes its part of the force that is left.
        left = stiffness * hypot(across_m, out_m)
        kept = max(1.0 - rubbing_N / left, 0.0) if left > 0.0 else 0.0
        return kept * across_m, kept * out_m

    def _sides_at(self, along_m: float, depth_m: float) -> tuple[_Side, _Side, _Side]:
        """Return the resistance of edge, front and back for a trial place of the blade.

        The edge cuts what the blade covers before and after the step, front and back the rest.
        """
        start_s, start_l = self.place_m
        spacing = self._spacing_m
        cover, held, first = self._covered(along_m, depth_m)
        new = cover - held
        moved = along_m - start_s
        begin = max(along_m, start_s) / spacing - first
        end = (min(along_m, start_s) + self.width_m) / spacing - first
        low = max(floor(begin) + 1, 0)
        high = min(floor(end), len(new))
        under = new[low:high]
        touched = (under >= -TOUCH_M) & (cover[low:high] > 0.0)
        count = int(np.count_nonzero(touched))
        edge = _Side(0.0, 0.0)
        if count:
            gap = (depth_m - start_l) - self._slope * moved - float(under[touched].sum()) / count
            # Parts of columns at the ends of the edge count as their neighbours.
            width = count + touched[0] * (low - begin) + touched[-1] * (end - high)
            surface = self._surface(along_m, depth_m)
            crossed = floor(surface) - low
            if 0 <= crossed < len(under) and touched[crossed]:
                dry = surface % 1.0 if self._slope > 0.0 else 1.0 - surface % 1.0
                width -= dry
            edge = self._side(width * spacing, gap)
        last = depth_m + self._slope * self.width_m
        front = self._beside(new[high:], last, first + len(new), moved)
        back = self._beside(new[:low], depth_m, first - 1, -moved)
        return edge, front, back

    def _beside(self, new: Array, depth_m: float, column: int, travel_m: float) -> _Side:
        """Return the resistance of the front or the back, with the depth of its lower end [m].

        ``new`` is the covered less the cut depth of the columns that it has reached [m], ``column``
        is the next one.
        """
        ahead = column - self._first
        uncut = max(depth_m, 0.0)
        if 0 <= ahead < len(self._cut):
            uncut -= float(self._cut[ahead])
        if uncut <= TOUCH_M:
            return _Side(0.0, 0.0)
        fresh = float(np.maximum(new, 0.0).sum()) * self._spacing_m
        return self._side(uncut, max(travel_m - fresh / uncut, 0.0))

    def _side(self, length_m: float, gap_m: float) -> _Side:
        """Return the resistance of a side with a length in uncut tissue."""
        return _Side(self._tissue.toughness_J_m2 * self._cosine * length_m, gap_m)

    def _covered(self, along_m: float, depth_m: float) -> tuple[Array, Array, int]:
        """Return the columns under the blade: covered and cut mean depth [m], and the first one."""
        spacing = self._spacing_m
        first = floor(along_m / spacing)
        self._grow(first, first + COLUMNS + 1)
        # The blade covers the last part of the first column, and the first part of the last one.
        inside = along_m / spacing - first
        # Depths at the middles of the columns.
        cover = self._rises + (depth_m + self._slope * (0.5 - inside) * spacing)
        np.maximum(cover, 0.0, out=cover)
        end = depth_m + self._slope * self.width_m
        cover[0] = (1.0 - inside) * self._mean(depth_m, (1.0 - inside) * spacing)
        cover[-1] = inside * self._mean(end - self._slope * inside * spacing, inside * spacing)
        # An edge that leaves the tissue within a column covers a triangle.
        crossed = floor(self._surface(along_m, depth_m))
        if 0 < crossed < COLUMNS:
            at = depth_m + self._slope * (crossed - inside) * spacing
            cover[crossed] = self._mean(at, spacing)
        begin = first - self._first
        return cover, self._cut[begin : begin + COLUMNS + 1], first

    def _surface(self, along_m: float, depth_m: float) -> float:
        """Return where the edge leaves the tissue, in columns from the first one; -1 if it does not.
        """
        if depth_m * (depth_m + self._slope * self.width_m) >= 0.0:
            return -1.0
        return along_m / self._spacing_m % 1.0 - depth_m / (self._slope * self._spacing_m)

    def _mean(self, depth_m: float, width_m: float) -> float:
        """Return the mean depth [m] in the tissue of a part of the edge from its first depth on."""
        end = depth_m + self._slope * width_m
        top = max(depth_m, end)
        bottom = min(depth_m, end)
        if bottom >= 0.0 or top <= 0.0:
            return max(0.5 * (top + bottom), 0.0)
        return 0.5 * top * top / (top - bottom)

    def _part(self, along_m: float, depth_m: float) -> None:
        """Put the blade at a position in the tissue: cut, and part the walls that it leaves."""
        cover, held, first = self._covered(along_m, depth_m)
        fresh = np.maximum(cover - held, 0.0)
        begin = first - self._first
        now = slice(begin, begin + len(cover))
        left = np.minimum(self._touching[now], cover)
        self._touching[self._window - self._first :][: len(cover)] = 0.0
        self._touching[now] = left + fresh
        held += fresh
        self._window = first
        passed = self._passed(along_m, depth_m)
        scale = self._cosine * self._spacing_m
        self.area_m2 += scale * (float(fresh.sum()) + passed)
        self.touching_m2 = scale * float(self._touching[now].sum())
        self.place_m = (along_m, depth_m)

    def _passed(self, along_m: float, depth_m: float) -> float:
        """Cut the columns that the deepest point of the edge has passed down to its depth.

        A column under the blade is never covered to that depth as a whole. Returns the sum of the
        added mean depths [m].
        """
        start_s, start_l = self.place_m
        ahead = self.width_m if self._slope > 0.0 else 0.0
        before = floor((start_s + ahead) / self._spacing_m)
        now = floor((along_m + ahead) / self._spacing_m)
        if before == now:
            return 0.0
        columns = slice(min(before, now + 1) - self._first, max(before + 1, now) - self._first)
        deepest = self.deepest_m(min(start_l, depth_m))
        held = self._cut[columns]
        added = np.maximum(deepest - held, 0.0)
        held += added
        return float(added.sum())

    def _grow(self, first: int, last: int) -> None:
        """Store columns from a first to a last one."""
        before = max(self._first - first + CHUNK, 0) if first < self._first else 0
        end = self._first + len(self._cut)
        after = last - end + CHUNK if last > end else 0
        if before or after:
            self._cut = np.pad(self._cut, (before, after))
            self._touching = np.pad(self._touching, (before, after))
            self._first -= before

