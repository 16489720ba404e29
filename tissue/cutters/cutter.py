"""Cutter: a profile with flutes.

A cutter provides a distance table for carving and a point shell for forces.
"""

from dataclasses import dataclass
from math import ceil, pi, sqrt

import numpy as np

from kernels.revolution import EDGE_BEND
from meshes.base.arrays import Array, Ints, Singles, lattice
from meshes.base.cache import RecentResults
from meshes.base.errors import counted
from meshes.base.hints import suggests_arguments
from tissue.cutters.profile import Piece, Profile

TABLE_ERROR_VOXELS = 2.0e-4
"""Error of the distance table [voxel], curvature x cell^2 / 8.

The error is less than one step of the stored distances, which is 1/4096 voxel. The limits
`CELLS_PER_VOXEL` take precedence over this error.
"""
CELLS_PER_VOXEL = 2.0, 6.0
"""Smallest and largest number of table cells per voxel.

Above a tool radius of 156 voxels, two cells are enough for `TABLE_ERROR_VOXELS`. Below a radius of
17 voxels, six cells are not enough. At a radius of 5 voxels the error is 7e-4 voxels.
"""
EDGE_REACH_VOXELS = 3.0
"""Distance from an edge of the profile [voxel] within which voxels are cut one by one.

The distance is larger than the half diagonal of a block of 2 x 2 x 2 voxels.
"""
PATCH = 128
SMALL_PATCH = 8
"""Number of neighbouring surface elements in a small patch.

A patch consists of small patches and holds `PATCH` elements.

The elements of a patch have similar normals and touch the same voxels. The kernels process these
elements together, see `kernels.elements.CHUNK` and `kernels.elements.LANES`.
"""
GOLDEN = 0.6180339887498949
"""Fraction of a turn between consecutive elements of a Fibonacci lattice: 1 / golden ratio."""
MARGIN_VOXELS = 10.0
"""Margin of the distance table around the tool [voxel].

The margin is larger than the half diagonal of a block of 8 x 8 x 8 voxels.
"""


@dataclass(frozen=True)
class PointShell:
    """Elements of a cutter's surface, in the frame of the tool.

    The origin of this frame is at the tip, and z points along the axis.

    Attributes
    ----------
    points_m
        Positions [m], shape (n, 3).
    normals
        Outward unit normals, shape (n, 3).
    areas_m2
        Areas [m2], shape (n,).
    radii_m
        Distances from the axis [m], shape (n,).
    """

    points_m: Array
    normals: Array
    areas_m2: Array
    radii_m: Array


@dataclass(frozen=True)
class DistanceTable:
    """Signed distance from a cutter's surface [voxel] as a function of radius and height [voxel].

    The arrays are used by `kernels.revolution.Revolution`.
    """

    distance: Singles
    slope: Singles
    bend: Singles
    height_min: float
    cells_per_voxel: float
    radius: float
    low: float
    high: float

    def bend_at(self, radius: Array, height: Array) -> Singles:
        """Return a sixth of the sum of the principal curvatures at points [1/voxel], shape (n,).

        The curvatures are those of the cutter's offset surface through each point. The points are
        given by radius and height above the tip [voxel]. Near an edge of the profile, the value is
        `kernels.revolution.EDGE_BEND`.
        """
        u = radius * self.cells_per_voxel
        v = (height - self.height_min) * self.cells_per_voxel
        last = self.bend.shape[0] - 2, self.bend.shape[1] - 2
        return self.bend[np.clip(u.astype(int), 0, last[0]), np.clip(v.astype(int), 0, last[1])]


@suggests_arguments
@dataclass(frozen=True)
class Cutter:
    """Rotating cutter.

    Attributes
    ----------
    profile
        Half section of the cutter.
    flute_count
        Number N of cutting edges around the axis.
    spin_rad_s
        Angular velocity [rad/s]. It is positive for a right-handed rotation about the axis from tip
        to shank. A common right-hand drill or mill turns clockwise as seen from its shank, so its
        spin is negative. The spin of a tool that cuts must not be zero.
    """

    profile: Profile
    flute_count: int
    spin_rad_s: float

    def __repr__(self) -> str:
        diameter_mm = 2e3 * self.profile.radius_m
        rpm = -self.spin_rad_s * 60.0 / (2.0 * pi)
        return (
            f"Cutter({diameter_mm:.4g} mm wide, {counted(self.flute_count, 'flute')}, "
            f"{rpm:.6g} turns a minute)"
        )

    @property
    def chip_per_speed_s(self) -> float:
        """Chip thickness divided by the feed velocity normal to the surface, 2 pi / (N omega) [s].

        N is `flute_count`, and omega is the magnitude of `spin_rad_s`.
        """
        return 2.0 * pi / (self.flute_count * abs(self.spin_rad_s))

    @property
    def tooth_passing_Hz(self) -> float:
        """Rate at which cutting edges pass a fixed point [Hz]."""
        return self.flute_count * abs(self.spin_rad_s) / (2.0 * pi)

    @property
    def cutting_area_m2(self) -> float:
        """Area of the cutting surface [m2]."""
        return sum(piece.area_m2 for piece in self.profile.pieces if piece.cutting)

    def shell(self, *, spacing_m: float, cutting: bool = True) -> PointShell:
        """Return the point shell of the cutting surface, or of the smooth surface.

        The smooth surface, which does not cut, is used if `cutting` is False.

        The distance between elements is about ``spacing_m``; near the axis it is smaller. On each
        piece of the profile, the elements form a Fibonacci lattice: a spiral with the golden angle
        between consecutive elements. On a piece that is not flat, the elements lie at different
        heights. The edge of a cut region therefore never passes many elements at the same time. As
        the spacing decreases, sums over the elements of a part converge almost as fast as sums over
        all elements.
        """
        key = self.profile, spacing_m, cutting
        return _shells.of(key, lambda: self._shell(spacing_m, cutting))

    def coarse_shell_m(self, *, cutting: bool = True) -> Array:
        """Return a few points of the cutting or the smooth surface [m], shape (n, 3).

        The simulated region is chosen so that it contains these points throughout the planned
        motion.
        """
        if not cutting and not self.has_smooth_surface:
            return np.zeros((0, 3))
        # With points an eighth of the radius apart, at most 0.09 mm of the reach is missed in the
        # built-in scenes. This is much less than the margin of the voxels.
        return self.shell(spacing_m=self.profile.radius_m / 8.0, cutting=cutting).points_m

    def coarse_surface_m(self) -> Array:
        """Return a few points of the cutting and then of the smooth surface [m], shape (n, 3).

        See `coarse_shell_m`.
        """
        return np.concatenate([self.coarse_shell_m(), self.coarse_shell_m(cutting=False)])

    def load_factors(self, radii_m: Array) -> Array:
        """Return the factors that multiply the tangential and the radial load, shape (n, 2).

        `radii_m` contains the distances of the n elements from the axis [m].

        The factors are 1 unless the cutter is a drill with a chisel edge.
        """
        point = self.profile.point
        return np.ones((len(radii_m), 2)) if point is None else point.load_factors(radii_m)

    @property
    def has_smooth_surface(self) -> bool:
        """True if a part of the surface, such as a peg or a flat top, does not cut."""
        return not all(piece.cutting for piece in self.profile.pieces)

    def _shell(self, spacing_m: float, cutting: bool) -> PointShell:
        """Compute the point shell of the cutting or the smooth surface, without the cache."""
        parts = [
            spiral(piece, spacing_m=spacing_m)
            for piece in self.profile.pieces
            if piece.cutting == cutting
        ]
        points, normals, areas = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.concatenate(_patches(points, np.arange(len(points))))
        points = points[order]
        normals = normals[order]
        areas = areas[order]
        return PointShell(points, normals, areas, np.hypot(points[:, 0], points[:, 1]))

    def table(self, *, spacing_m: float) -> DistanceTable:
        """Return the distance table of the cutter for voxels of size ``spacing_m``."""
        return _tables.of((self.profile, spacing_m), lambda: self._table(spacing_m))

    def _table(self, spacing_m: float) -> DistanceTable:
        """Compute the distance table, without the cache."""
        low, high = (h / spacing_m for h in self.profile.height_range_m)
        reach = self.profile.radius_m / spacing_m
        cells = float(
            np.clip(ceil(sqrt(1.0 / (8.0 * TABLE_ERROR_VOXELS * reach))), *CELLS_PER_VOXEL)
        )
        height_min = low - MARGIN_VOXELS
        r = np.arange(ceil((reach + MARGIN_VOXELS) * cells) + 2) / cells
        z = np.arange(ceil((high - low + 2.0 * MARGIN_VOXELS) * cells) + 2) / cells + height_min
        grid = lattice(r, z)
        distance, meridional = self.profile.distance(grid * spacing_m)
        distance = (distance / spacing_m).reshape(len(r), len(z))
        slope = np.stack(np.gradient(distance, 1.0 / cells), axis=-1)
        # Half a voxel: on the axis the radius is 0.
        azimuthal = slope[..., 0] / np.maximum(r, 0.5)[:, None]
        bend = np.clip(meridional.reshape(distance.shape) * spacing_m, 0.0, 1.0) + np.clip(
            azimuthal, -1.0, 1.0
        )
        # A sixth of the sum of the curvatures, see `kernels.revolution.Revolution`.
        bend /= 6.0
        for corner in self.profile.edges:
            near = np.linalg.norm(grid - corner / spacing_m, axis=1) < EDGE_REACH_VOXELS
            bend[near.reshape(bend.shape)] = EDGE_BEND
        return DistanceTable(
            distance.astype(np.float32),
            slope.astype(np.float32),
            bend.astype(np.float32),
            height_min,
            cells,
            reach,
            low,
            high,
        )


_tables: RecentResults[DistanceTable] = RecentResults(8)
_shells: RecentResults[PointShell] = RecentResults(8)
"""Cache of point shells, keyed by profile and spacing of elements.

`_tables` is the cache of distance tables, keyed by profile and spacing of voxels.
"""


def spiral(piece: Piece, *, spacing_m: float) -> tuple[Array, Array, Array]:
    """Return positions [m], normals and areas [m2] of the surface elements on a piece."""
    # At least 16 elements in a piece; chosen.
    count = max(ceil(piece.area_m2 / spacing_m**2), 16)
    share = np.linspace(0.0, 1.0, 4097)
    radius = piece.at(share)[0][:, 0]
    # Half of the elements are distributed by area, and half by length of the profile, because the
    # edge force on a ring depends only on its width.
    density = radius / radius.mean() + 1.0
    below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    at = np.interp((np.arange(count) + 0.5) / count, below / below[-1], share)
    profile, direction = piece.at(at)
    areas = profile[:, 0] / (profile[:, 0] / radius.mean() + 1.0)
    areas *= piece.area_m2 / areas.sum()
    angle = 2.0 * pi * GOLDEN * np.arange(count)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.column_stack([profile[:, :1] * around, profile[:, 1]])
    normals = np.column_stack([direction[:, :1] * around, direction[:, 1]])
    return points, normals, areas


def _patches(points: Array, chosen: Ints) -> list[Ints]:
    """Return indices of points, ordered in patches of `SMALL_PATCH` neighbours.

    The set of points is repeatedly split in half along its longest side. Consecutive small patches
    form patches of `PATCH` points. The last patch may be smaller.
    """
    if len(chosen) <= SMALL_PATCH:
        return [chosen]
    size = PATCH if len(chosen) > PATCH else SMALL_PATCH
    side = int(np.argmax(np.ptp(points[chosen], axis=0)))
    sorted_ = chosen[np.argsort(points[chosen, side], kind="stable")]
    half = size * max(round(len(chosen) / size / 2), 1)
    return _patches(points, sorted_[:half]) + _patches(points, sorted_[half:])
