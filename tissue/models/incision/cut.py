"""Plane cut of a straight edge: cut area, parted walls, and the balance of a blade on tissue."""

from math import hypot

import numpy as np

from meshes.base.arrays import Array
from tissue.models.incision.parameters import Blade, IncisedTissue

__all__ = ["Cut"]

COLUMNS = 512
"""Number of columns across a blade that store the cut.

The force of an oblique push is off by at most one column of these, 0.2 %; a push along the axis and
a slice along the surface are exact.
"""
CHUNK = 4 * COLUMNS
"""Number of columns by which the stored part of a cut grows."""
ONSET_M = 1e-9
"""Travel at which the resistance of a blade at rest is evaluated [m]; far below a tick's travel."""
TOLERANCE = 1e-6
"""Largest error of the balance, as a ratio to the pull at the start of a step."""
STEPS = 30
"""Largest number of steps of the search for the balance; three are usual."""


class Cut:
    """Cut in one plane, made by a blade that does not turn, and the blade's position in it.

    A point of the plane has the coordinates s along the surface and l along the blade's axis, into
    the tissue. The blade covers everything above its straight edge, so the cut is the region above
    a depth profile over s. Columns of equal width hold the cut area, and the part of it whose walls
    still touch the blade. Walls touch from the cut on. They part as soon as the blade uncovers
    them, and then stay apart.

    Only the blade carries the tissue, as in `tissue.models.needle.model.Insertion`. With u the
    distance from the blade's position in the tissue to the tool, in the plane of the cut, the
    tissue pulls with k u towards the tool's way back. The blade cuts along u, so the force is
    parallel to the motion through the tissue (Atkins, Xu and Jeronimidis 2004). In equilibrium::

        k u  =  J dA/dx + 2 tau M

    with x the travel through the tissue, A the cut area and M the area of each wall that touches
    the blade. J dA/dx is the force at which the energy release reaches the toughness. A smaller
    pull leaves the blade where it is in the tissue. The work of the tool therefore equals the
    change of k u²/2, plus J A, plus the work of friction.

    Attributes
    ----------
    place_m
        s and l of the blade's tip in the tissue [m].
    pull_N
        Pull of the tissue in the plane, along the surface and out of it [N].
    area_m2
        Area cut so far, one side [m2].
    touching_m2
        Area of each wall that touches the blade [m2].
    friction_J
        Work of friction so far [J].
    """

    def __init__(self, tissue: IncisedTissue, blade: Blade, tip_m: Array, rotation: Array) -> None:
        self._tissue = tissue
        self._stiffness = tissue.stiffness_N_m(blade)
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
        self._first = -CHUNK
        self._cut, self._touching = np.zeros((2, 2 * CHUNK))
        self._window = (0, 0)
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

    def advance(self, along_m: float, depth_m: float) -> None:
        """Move the tool to a position, and the blade in the tissue to its balance."""
        start_s, start_l = self.place_m
        # Stretch in orthogonal directions: along the surface and out of it.
        out = -(depth_m - start_l) * self._cosine
        across = (along_m - start_s) - (depth_m - start_l) * self._sine
        stretch = hypot(across, out)
        moved = self._balanced(stretch, along_m - start_s, depth_m - start_l)
        share = moved / stretch if stretch > 0.0 else 0.0
        self.friction_J += 2.0 * self._tissue.friction_Pa * self.touching_m2 * moved
        self._part(start_s + share * (along_m - start_s), start_l + share * (depth_m - start_l))
        pull = self._stiffness * (1.0 - share)
        self.pull_N = (-pull * across, -pull * out)

    def profile_m(self) -> tuple[Array, Array]:
        """Return middles of the columns and mean depths of the cut in them [m]."""
        middles = (self._first + 0.5 + np.arange(len(self._cut))) * self._spacing_m
        cut = self._cut > 0.0
        return middles[cut], self._cut[cut] / self._spacing_m

    def _balanced(self, stretch: float, along_m: float, depth_m: float) -> float:
        """Return the travel through the tissue at which pull and resistance are equal [m]."""
        stiffness = self._stiffness
        rubbing = 2.0 * self._tissue.friction_Pa * self.touching_m2
        start_s, start_l = self.place_m

        def excess(travel: float) -> float:
            share = travel / stretch
            cover, held, _ = self._covered(start_s + share * along_m, start_l + share * depth_m)
            new = self._cosine * float(np.maximum(cover - held, 0.0).sum())
            resistance = self._tissue.toughness_J_m2 * new / travel + rubbing
            return stiffness * (stretch - travel) - resistance

        close = TOLERANCE * stiffness * stretch
        if stiffness * stretch <= rubbing:
            return 0.0
        high = stretch
        over = excess(high)
        if over >= -close:
            return high
        low = min(ONSET_M, 0.5 * stretch)
        under = excess(low)
        if under <= 0.0:
            return 0.0
        # Regula falsi of Illinois: the resistance hardly changes along a step.
        side = 0
        travel = low
        for _ in range(STEPS):
            travel = low + (high - low) * under / (under - over)
            found = excess(travel)
            if abs(found) <= close:
                break
            if found > 0.0:
                low = travel
                under = found
                over *= 0.5 if side > 0 else 1.0
                side = 1
            else:
                high = travel
                over = found
                under *= 0.5 if side < 0 else 1.0
                side = -1
        return travel

    def _covered(self, along_m: float, depth_m: float) -> tuple[Array, Array, slice]:
        """Return covered and cut area of each column under the blade [m2], and these columns.

        Areas are those of a blade at right angles to the surface.
        """
        spacing = self._spacing_m
        first = int(np.floor(along_m / spacing))
        last = first + COLUMNS + 1
        self._grow(first, last)
        bounds = np.arange(first, last + 1) * spacing - along_m
        bounds[0] = 0.0
        bounds[-1] = self.width_m
        # Rounding may leave the last column but one beyond the end of the edge.
        np.minimum(bounds, self.width_m, out=bounds)
        depth = depth_m + self._slope * bounds
        top = np.maximum(depth[1:], depth[:-1])
        bottom = np.minimum(depth[1:], depth[:-1])
        np.maximum(top, 0.0, out=top)
        # An edge that leaves the tissue within a column covers a triangle.
        triangle = top * top / np.maximum(top - bottom, 1e-300)
        mean = 0.5 * np.where(bottom >= 0.0, top + bottom, triangle)
        columns = slice(first - self._first, last - self._first)
        return mean * np.diff(bounds), self._cut[columns], columns

    def _part(self, along_m: float, depth_m: float) -> None:
        """Put the blade at a position in the tissue: cut, and part the walls that it leaves."""
        cover, held, columns = self._covered(along_m, depth_m)
        fresh = np.maximum(cover - held, 0.0)
        before = slice(*(bound - self._first for bound in self._window))
        left = self._touching[columns].copy()
        self._touching[before] = 0.0
        self._touching[columns] = np.minimum(left, cover) + fresh
        held += fresh
        self._window = (columns.start + self._first, columns.stop + self._first)
        self.area_m2 += self._cosine * float(fresh.sum())
        self.touching_m2 = self._cosine * float(self._touching[columns].sum())
        self.place_m = (along_m, depth_m)

    def _grow(self, first: int, last: int) -> None:
        """Store columns from a first to a last one."""
        before = max(self._first - first + CHUNK, 0) if first < self._first else 0
        end = self._first + len(self._cut)
        after = last - end + CHUNK if last > end else 0
        if before or after:
            self._cut = np.pad(self._cut, (before, after))
            self._touching = np.pad(self._touching, (before, after))
            self._first -= before
