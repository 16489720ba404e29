"""Cut in one plane by a blade with a straight edge: force balance, cut area, wall separation."""

from math import floor, hypot

import numpy as np

from meshes.base.arrays import Array
from tissue.models.incision.parameters import Blade, IncisedTissue

COLUMNS = 512
"""Number of columns across the width of a blade that store the depth of the cut.

Each column stores one mean depth. For a pointed blade, the relative error of the cut area is
therefore about half a column's width divided by the depth of the cut. If the depth of the cut
equals the width of the blade, the error is 0.2 %.
"""
CHUNK = 4 * COLUMNS
"""Number of columns that are added when the arrays of a cut grow."""
SWEEPS = 12
SETTLED_N = 1e-8
"""Allowed force error in the search for the force balance of the blade [N].

The search has at most `SWEEPS` sweeps. A sweep solves for the force of the edge, and then for the
force of the sides. The search starts from the balance in the last step. For an edge of 45 degrees
each sweep halves the error.
"""


class Cut:
    """Cut in one plane by a blade that does not rotate, and the position of the blade in the cut.

    A point of the plane has the coordinates s (along the surface) and l (along the blade's axis,
    positive into the tissue). The blade covers the region above its straight edge. The cut is
    therefore the region above a depth profile along s. The profile is stored in columns of equal
    width. Each column has two mean depths: the depth of the cut, and the depth over which its walls
    touch the blade. Newly cut walls touch the blade. A wall separates from the blade when the blade
    no longer covers it. A separated wall never touches the blade again.

    Only the blade acts on the tissue. The pull of the tissue therefore equals the force of the
    blade, as in `tissue.models.needle.model.Insertion`. Let q be the position of the blade relative
    to the tissue. Let u be the vector from q to the position of the tool, in the plane of the cut.
    The tissue pulls the blade with the force -k u, where k is the stiffness. In every step, q
    minimises the following energy, where q_before is q in the previous step::

        k u²/2  +  J A(q)  +  2 tau M |q - q_before|

    Here A is the cut area, M is the area of each wall in contact with the blade, and tau is the
    friction per area. J is the energy release rate at which the blade cuts (Francfort and Marigo
    1998). A side of the blade cuts when the force normal to it reaches J times the length of the
    side that lies in uncut tissue. Under a smaller force the blade does not move in the tissue.
    Motion of the edge along its own direction has no resistance. The work of the tool equals the
    change of k u²/2, plus the increase of J A, plus the work of friction. Except for terms of
    second order in the step, the energy is convex in q. Therefore q moves by no more than the tool
    moves.

    Attributes
    ----------
    place_m
        Coordinates s and l of the blade's tip relative to the tissue [m]; q in the equations.
    pull_N
        Force of the tissue on the blade in the plane of the cut [N]. The two components point along
        the surface and out of the surface.
    area_m2
        Area cut so far [m2]; the two walls are counted once.
    touching_m2
        Area of each wall that touches the blade [m2].
    friction_J
        Work of friction so far [J].
    """

    def __init__(self, tissue: IncisedTissue, blade: Blade, tip_m: Array, rotation: Array) -> None:
        self._tissue = tissue
        self.axis = rotation[:, 2].copy()
        self.across = rotation[:, 1].copy()
        # Direction along the surface, from the tip towards the end of the edge.
        along = np.array([self.across[1], -self.across[0], 0.0])
        self.along = along / np.linalg.norm(along)
        self.up = np.cross(self.along, self.across)
        self._sine = float(self.axis @ self.along)
        self._cosine = float(self.axis @ self.up)
        self.width_m = blade.width_m / self._cosine
        self._slope = self._sine - self._cosine * blade.rise
        self._spacing_m = self.width_m / COLUMNS
        # The tip enters in the middle of a column, so that rounding does not move it to the next
        # column.
        entry = tip_m - tip_m[2] / self.axis[2] * self.axis
        self.origin_m = entry - 0.5 * self._spacing_m * self.along
        self._rises = self._slope * self._spacing_m * np.arange(COLUMNS + 1)
        self._first = -CHUNK
        self._cut, self._touching = np.zeros((2, 2 * CHUNK))
        self._window = 0
        # Travel of edge and of sides into the tissue, per travel along the surface and out of the
        # surface.
        lean = self._sine / self._cosine
        self._edge = -self._slope, self._slope * lean - 1.0 / self._cosine
        self._side = 1.0, -lean
        self._forces_N = (0.0, 0.0)
        self._moved_m = 0.0
        self.place_m = (0.0, 0.0)
        self.pull_N = (0.0, 0.0)
        self.area_m2 = 0.0
        self.touching_m2 = 0.0
        self.friction_J = 0.0

    def coordinates_m(self, tip_m: Array) -> tuple[float, float, float]:
        """Return coordinates s and l of a point, and its distance from the cut plane [m].

        The coordinate s runs along the surface, and l along the blade's axis into the tissue.
        """
        arm = tip_m - self.origin_m
        depth = -float(arm @ self.up) / self._cosine
        return float(arm @ self.along) + depth * self._sine, depth, float(arm @ self.across)

    def deepest_m(self, depth_m: float) -> float:
        """Return the depth of the deepest point of the edge for a given depth of the tip [m]."""
        return depth_m + max(self._slope * self.width_m, 0.0)

    def enter(self, along_m: float) -> None:
        """Place the blade so that its deepest point touches the surface."""
        self.place_m = (along_m, -self.deepest_m(0.0))
        self.pull_N = (0.0, 0.0)
        self._forces_N = (0.0, 0.0)
        self._moved_m = 0.0

    def advance(self, along_m: float, depth_m: float) -> None:
        """Move the tool to a position, and move the blade to the place where its forces balance."""
        start_s, start_l = self.place_m
        stiffness = self._tissue.stiffness_N_m
        # Components of u along the surface and out of the surface, which are orthogonal.
        out = -(depth_m - start_l) * self._cosine
        across = (along_m - start_s) - (depth_m - start_l) * self._sine
        edge = self._gaps_m(hypot(*self._edge) * hypot(across, out))
        moved_across, moved_out = self._moved(across, out, *edge)
        # Friction acts against the motion that the blade would have without friction.
        moved = hypot(moved_across, moved_out)
        rubbing = 2.0 * self._tissue.friction_Pa * self.touching_m2
        share = min(rubbing / (stiffness * moved), 1.0) if moved > 0.0 else 0.0
        if share > 0.0:
            sense = moved_across / moved, moved_out / moved
            moved_across, moved_out = self._moved(
                across - share * moved_across, out - share * moved_out, *edge
            )
            self.friction_J += rubbing * (moved_across * sense[0] + moved_out * sense[1])
        deeper = -moved_out / self._cosine
        self._moved_m = moved_across + deeper * self._sine
        self._part(start_s + self._moved_m, start_l + deeper)
        self.pull_N = -stiffness * (across - moved_across), -stiffness * (out - moved_out)

    def profile_m(self) -> tuple[Array, Array]:
        """Return position along the surface and mean depth of each column of the cut [m]."""
        columns = np.arange(len(self._cut), dtype=np.float64)
        middles = self._spacing_m * (self._first + 0.5 + columns)
        cut = self._cut > 0.0
        return middles[cut], self._cut[cut]

    def _moved(
        self, across_m: float, out_m: float, gaps_m: Array, widths_m: Array
    ) -> tuple[float, float]:
        """Return the travel along the surface and out of it that minimises the energy [m].

        Friction is neglected. The resistance of the edge depends only on the travel of the edge
        into the tissue. The resistance of the front and back side of the blade depends on the
        travel along the surface. The force of the edge and the force of the sides are computed in
        turn.
        """
        stiffness = self._tissue.stiffness_N_m
        scale = self._tissue.toughness_J_m2 * self._cosine / stiffness
        edge_across, edge_out = self._edge
        side_across, side_out = self._side
        edge_square = edge_across**2 + edge_out**2
        side_square = side_across**2 + side_out**2
        count = len(gaps_m)
        # Values of u across the edge at which the travel of the edge equals a gap.
        held = np.add.accumulate(scale * edge_square * widths_m)
        bounds = gaps_m + held - 0.5 * scale * edge_square * widths_m
        edge_N, side_N = self._forces_N
        for _ in range(SWEEPS):
            left_across = across_m - side_N / stiffness * side_across
            left_out = out_m - side_N / stiffness * side_out
            stretch = left_across * edge_across + left_out * edge_out
            travel = stretch
            if count and stretch > gaps_m[0]:
                travel = max(stretch - float(held[-1]), float(np.interp(stretch, bounds, gaps_m)))
            edge_N = (stretch - travel) * stiffness / edge_square
            left_across = across_m - edge_N / stiffness * edge_across
            left_out = out_m - edge_N / stiffness * edge_out
            stretch = left_across * side_across + left_out * side_out
            travel = self._along_m(stretch, scale * side_square)
            before_N = side_N
            side_N = (stretch - travel) * stiffness / side_square
            if abs(side_N - before_N) <= SETTLED_N:
                break
        self._forces_N = edge_N, side_N
        push = edge_N / stiffness, side_N / stiffness
        return (
            across_m - push[0] * edge_across - push[1] * side_across,
            out_m - push[0] * edge_out - push[1] * side_out,
        )

    def _gaps_m(self, reach_m: float) -> tuple[Array, Array]:
        """Return gaps between the edge and uncut tissue, smallest first, and their widths [m].

        A gap is the travel at which a part of the edge reaches uncut tissue. Its width is the width
        of this part, or zero if the gap is larger than `reach_m`. Columns that the tip or the end
        of the edge will pass in this step are left out. The motion in the last step predicts which
        columns these are.
        """
        along, depth = self.place_m
        spacing = self._spacing_m
        begin = (along + max(self._moved_m, 0.0)) / spacing
        end = (along + min(self._moved_m, 0.0)) / spacing + COLUMNS
        first = floor(begin) + 1
        count = floor(end) - first
        if count < 1:
            return np.zeros(0), np.zeros(0)
        self._grow(first - 1, first + count)
        columns = slice(first - self._first, first - self._first + count)
        # Depth of the edge in the middle of the first whole column.
        start = depth + self._slope * ((first + 0.5) * spacing - along)
        gaps = self._cut[columns] - self._rises[:count] - start
        widths = np.full(count, spacing)
        # Partial columns at the ends of the edge get the gap of their neighbours.
        widths[0] += (first - begin) * spacing
        widths[-1] += (end - first - count) * spacing
        # The gaps are rounded to a picometre, so that equal gaps stay in the order of the columns.
        gaps = gaps.round(12)
        widths[gaps >= reach_m] = 0.0
        order = gaps.argsort(kind="stable")
        return np.minimum(gaps[order], reach_m), widths[order]

    def _along_m(self, stretch_m: float, compliance: float) -> float:
        """Return the travel along the surface [m] at which a side of the blade balances the pull.

        ``stretch_m`` is the distance along the surface from the blade to the tool [m]; the pull is
        proportional to the stretch. At the balance, the stretch is ``compliance`` times the length
        of the side in uncut tissue.
        """
        along, depth = self.place_m
        spacing = self._spacing_m
        sense = 1 if stretch_m > 0.0 else -1
        at = along / spacing
        if sense > 0:
            at += COLUMNS
            depth += self._slope * self.width_m
        # The column of the side is cut behind the side; in front of it, its depth is taken from the
        # next column.
        column = floor(at) + sense
        bound = abs((column + (sense < 0)) - at) * spacing
        reached = 0.0
        while True:
            index = column - self._first
            held = float(self._cut[index]) if 0 <= index < len(self._cut) else 0.0
            left = abs(stretch_m) - compliance * max(depth - held, 0.0)
            if left <= bound + spacing:
                return sense * max(left, reached)
            column += sense
            bound += spacing
            reached = bound

    def _part(self, along_m: float, depth_m: float) -> None:
        """Move the blade to a position in the tissue, and update the cut and its walls.

        Columns that the blade covers are cut. Walls that the blade no longer covers separate from
        the blade.
        """
        spacing = self._spacing_m
        first = floor(along_m / spacing)
        self._grow(first, first + COLUMNS + 1)
        # Part of the edge in each column: depths at its ends, and mean depth in the tissue.
        bounds = np.arange(first, first + COLUMNS + 2) * spacing - along_m
        bounds = bounds.clip(0.0, self.width_m)
        depths = depth_m + self._slope * bounds
        bottom = np.minimum(depths[1:], depths[:-1])
        top = np.maximum(np.maximum(depths[1:], depths[:-1]), 0.0)
        # In the column where the edge leaves the tissue, the blade covers a triangle; 1e-300 avoids
        # a division by zero.
        mean = np.where(bottom >= 0.0, top + bottom, top**2 / np.maximum(top - bottom, 1e-300))
        cover = 0.5 * mean * np.diff(bounds) / spacing
        now = slice(first - self._first, first - self._first + len(cover))
        held = self._cut[now]
        fresh = np.maximum(cover - held, 0.0)
        touching = np.minimum(self._touching[now], cover) + fresh
        self._touching[self._window - self._first :][: len(cover)] = 0.0
        self._touching[now] = touching
        self._window = first
        held += fresh
        added = float(fresh.sum()) + self._passed(along_m, depth_m)
        self.area_m2 += self._cosine * spacing * added
        self.touching_m2 = self._cosine * spacing * float(touching.sum())
        self.place_m = (along_m, depth_m)

    def _passed(self, along_m: float, depth_m: float) -> float:
        """Cut the columns that the deepest point of the edge has passed.

        The columns are cut down to the depth of the deepest point. Without this extra cut the
        columns would remain too shallow, because the deepest point never covers the whole width of
        a column. Return the sum of the added mean depths [m].
        """
        start_s, start_l = self.place_m
        deepest = self.width_m if self._slope > 0.0 else 0.0
        before = floor((start_s + deepest) / self._spacing_m)
        now = floor((along_m + deepest) / self._spacing_m)
        if before == now:
            return 0.0
        columns = slice(min(before, now + 1) - self._first, max(before + 1, now) - self._first)
        depth = self.deepest_m(min(start_l, depth_m))
        held = self._cut[columns]
        added = np.maximum(depth - held, 0.0)
        held += added
        return float(added.sum())

    def _grow(self, first: int, last: int) -> None:
        """Extend the stored columns to the range from ``first`` to ``last``."""
        before = max(self._first - first + CHUNK, 0) if first < self._first else 0
        end = self._first + len(self._cut)
        after = last - end + CHUNK if last > end else 0
        if before or after:
            self._cut = np.pad(self._cut, (before, after))
            self._touching = np.pad(self._touching, (before, after))
            self._first -= before
