"""A cutter: a profile with flutes, as a distance table for carving and a point shell for forces."""

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
from numpy.typing import NDArray

from tissue.cutters.profile import Piece, Profile

__all__ = ["Cutter", "DistanceTable", "PointShell"]

CELLS_PER_VOXEL = 2.0
"""Resolution of the distance table; its error, curvature x cell^2 / 8, is 1e-3 voxel for a radius of 30 voxels."""
MARGIN_VOXELS = 10.0
"""The table reaches this far beyond the tool: more than the half diagonal of a brick."""


@dataclass(frozen=True)
class PointShell:
    """Elements of the cutting surface in the tool's frame: origin at the tip, z along the axis.

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

    points_m: NDArray[np.float64]
    normals: NDArray[np.float64]
    areas_m2: NDArray[np.float64]
    radii_m: NDArray[np.float64]


@dataclass(frozen=True)
class DistanceTable:
    """Signed distance over (radius, height) [voxel]; see :class:`kernels.revolution.Revolution`."""

    distance: NDArray[np.float32]
    bend: NDArray[np.float32]
    height_min: float
    cells_per_voxel: float
    radius: float
    low: float
    high: float


@dataclass(frozen=True)
class Cutter:
    """A rotating cutter.

    Attributes
    ----------
    profile
        Its half section.
    flute_count
        Cutting edges N around the axis.
    spin_rad_s
        Angular velocity about the axis [rad/s], positive by the right-hand rule about +z.
    """

    profile: Profile
    flute_count: int
    spin_rad_s: float

    @property
    def chip_per_speed_s(self) -> float:
        """Chip thickness over normal feed speed, 2 pi / (N omega) [s]."""
        return 2.0 * pi / (self.flute_count * self.spin_rad_s)

    @property
    def tooth_passing_Hz(self) -> float:
        """Rate at which edges pass a fixed point [Hz]."""
        return self.flute_count * self.spin_rad_s / (2.0 * pi)

    @property
    def cutting_area_m2(self) -> float:
        """Area of the cutting surface [m2]."""
        return sum(_ring_area(piece, 0.0, 1.0) for piece in self.profile.pieces if piece.cutting)

    def shell(self, *, spacing_m: float) -> PointShell:
        """Point shell with elements about ``spacing_m`` apart; rings of exact area, points at their middle."""
        points, normals, areas = [], [], []
        for piece in (p for p in self.profile.pieces if p.cutting):
            ring_count = max(ceil(piece.length_m / spacing_m), 2)
            cuts = np.linspace(0.0, 1.0, ring_count + 1)
            middles, directions = piece.at(0.5 * (cuts[:-1] + cuts[1:]))
            for ring, ((r, z), (nr, nz)) in enumerate(zip(middles, directions, strict=True)):
                area = _ring_area(piece, cuts[ring], cuts[ring + 1])
                count = max(8 * ceil(2.0 * pi * r / (8.0 * spacing_m)), 8)
                angle = 2.0 * pi * (np.arange(count) + 0.5) / count
                cosine, sine = np.cos(angle), np.sin(angle)
                points.append(np.column_stack([r * cosine, r * sine, np.full(count, z)]))
                normals.append(np.column_stack([nr * cosine, nr * sine, np.full(count, nz)]))
                areas.append(np.full(count, area / count))
        stacked = np.concatenate(points)
        return PointShell(
            stacked, np.concatenate(normals), np.concatenate(areas), np.hypot(stacked[:, 0], stacked[:, 1])
        )

    def table(self, *, spacing_m: float) -> DistanceTable:
        """Distance table in voxels of ``spacing_m``."""
        low, high = (h / spacing_m for h in self.profile.height_range_m)
        reach = self.profile.radius_m / spacing_m
        height_min = low - MARGIN_VOXELS
        r = np.arange(ceil((reach + MARGIN_VOXELS) * CELLS_PER_VOXEL) + 2) / CELLS_PER_VOXEL
        z = np.arange(ceil((high - low + 2.0 * MARGIN_VOXELS) * CELLS_PER_VOXEL) + 2) / CELLS_PER_VOXEL + height_min
        grid = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
        distance, meridional = self.profile.distance(grid * spacing_m)
        distance = (distance / spacing_m).reshape(len(r), len(z))
        slope = np.gradient(distance, 1.0 / CELLS_PER_VOXEL, axis=0)
        azimuthal = slope / np.maximum(r, 0.5)[:, None]
        bend = np.clip(meridional.reshape(distance.shape) * spacing_m, 0.0, 1.0) + np.clip(azimuthal, -1.0, 1.0)
        return DistanceTable(
            distance.astype(np.float32), (bend / 6.0).astype(np.float32), height_min, CELLS_PER_VOXEL, reach, low, high
        )


def _ring_area(piece: Piece, first: float, last: float) -> float:
    """Area [m2] swept by a part of a piece: 2 pi times the integral of the radius (three-point Gauss)."""
    node = np.sqrt(0.6)
    share = first + (last - first) * 0.5 * (1.0 + np.array([-node, 0.0, node]))
    radius = piece.at(share)[0][:, 0]
    return float(2.0 * pi * piece.length_m * (last - first) * (radius @ np.array([5.0, 8.0, 5.0]) / 18.0))
