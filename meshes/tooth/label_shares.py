"""A tooth's surface and layers between the voxels of its labels: one function of the file, whatever grid samples it.

Each layer's voxels are spread by the kernel of `meshes.images.label_spread` with a deviation of 1.5 voxels, and
interpolated: labels of planes and balls give their surface back to 0.08 voxels rms, without bias. A layer of two voxels
becomes a fifth of a voxel thicker on either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from math import ceil

import numpy as np

from meshes.base.arrays import Array, Bytes, Floats, Singles
from meshes.images.label_spread import spread_labels
from meshes.shapes.plane_cube import cube_fraction
from meshes.tooth.layers import LAYER_DENSITY_KG_M3, TOOTH_LAYERS
from meshes.voxels.grid import Grid

__all__ = ["REACH", "LabelShares"]

SPREAD = 1.5
"""Standard deviation of the Gaussian [voxel]: with 1.0 planes are off by 0.10 voxels rms, with 2.0 thin layers more."""
REACH = 8
"""Voxels around a region that its shares depend on: four deviations, one for the Laplacian and one to interpolate."""
_FARTHEST = 1.0
"""Distance [deviations] up to which a plane's share gives it: beyond, the share overshoots and comes back."""
_DENSITY_KG_M3 = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.float32)
_SURELY = 0.49
"""Off a half by more, a share has no surface within a voxel: it then lies among voxels of one kind."""
_HALF_DIAGONAL = 0.5 * 3.0**0.5
_THREADS = 2
_POINTS_AT_ONCE = 1 << 18


@dataclass(frozen=True, eq=False)
class LabelShares:
    """Shares of layers around any point of a box.

    Attributes
    ----------
    layers
        Layers that are there, uint8; of equal shares the first has the place.
    shares
        Share of each at the voxels, float32, shape (nx, ny, nz) each.
    solid
        Their sum.
    start, turn
        Index [voxel] of a point of the site frame [m]: ``start + turn @ point``.
    deviation_m
        Standard deviation of the Gaussian [m].
    voxel_m
        Smallest side of the labels' voxels [m].
    """

    layers: Bytes
    shares: tuple[Singles, ...]
    solid: Singles
    start: Array
    turn: Array
    deviation_m: float
    voxel_m: float

    @classmethod
    def of(
        cls,
        labels: Bytes,
        layers: Sequence[int],
        *,
        voxel_m: Array,
        start: Array,
        turn: Array,
    ) -> LabelShares:
        """Shares of layers in labels, shape (nx, ny, nz), of voxels with the sides `voxel_m`, shape (3,)."""
        deviation = SPREAD * float(voxel_m.max())
        there = [layer for layer in layers if (labels == layer).any()]

        def share(layer: int) -> Singles:
            return spread_labels((labels == layer).astype(np.float32), deviation / voxel_m)

        with ThreadPoolExecutor(_THREADS) as pool:
            shares = tuple(pool.map(share, there))
        solid = np.asarray(sum(shares, start=np.zeros(labels.shape, np.float32)))
        return cls(np.array(there, np.uint8), shares, solid, start, turn, deviation, float(voxel_m.min()))

    def sample(self, grid: Grid) -> tuple[Singles, Singles]:
        """Fraction of a grid's voxels, see `meshes.shapes.anatomy.GridSampler`; layers do not ask for the depth."""
        return self.fraction(grid), np.zeros(grid.shape, dtype=np.float32)

    def classify(self, points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Layer and density [kg/m3] at points, see `meshes.shapes.anatomy.Classify`."""
        layer = self.layer(points)
        return layer, _DENSITY_KG_M3[layer]

    def layer(self, points: Floats) -> Bytes:
        """Layer of the greatest share at points [m], shape (n, 3)."""
        if len(self.layers) == 0:
            return np.zeros(len(points), np.uint8)
        if len(self.layers) == 1:
            return np.full(len(points), self.layers[0], np.uint8)
        found = np.empty(len(points), dtype=np.uint8)
        for part in _parts(len(points)):
            at = self._index(points[part])
            found[part] = self.layers[np.argmax([_interpolated(share, at) for share in self.shares], axis=0)]
        return found

    def distance(self, points: Floats) -> Array:
        """Signed distance [m] to the surface at points [m], shape (n, 3); farther than a deviation a bound."""
        return -self.deviation_m * np.interp(self._solid_at(points), *_plane_share())

    def fraction(self, grid: Grid) -> Singles:
        """Part of each voxel of a grid inside, 0 to 1, the surface a plane in parts no larger than a label's voxel."""
        from scipy.ndimage import binary_dilation

        axes = [(np.arange(n) + f + 0.5) * grid.spacing_m for f, n in zip(grid.first, grid.shape, strict=True)]
        centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        share = self._solid_at(centres)
        result = (share > 0.5).astype(np.float32)
        side = result.reshape(grid.shape) > 0.5
        mixed = (np.abs(share - 0.5) < _SURELY).reshape(grid.shape)
        for axis in range(3):  # between neighbours on two sides there is a surface, however thin what it bounds
            low, high = ((slice(None),) * axis + (part,) for part in (slice(0, -1), slice(1, None)))
            mixed[low] |= side[low] != side[high]
        near = np.flatnonzero(binary_dilation(mixed, np.ones((3, 3, 3))))
        parts = max(ceil(grid.spacing_m / self.voxel_m - 1e-6), 1)
        size = grid.spacing_m / parts
        within = (np.arange(parts) - 0.5 * (parts - 1)) * size
        filled = np.zeros(len(near), dtype=np.float32)
        for shift in product(within, repeat=3):
            filled += self._part_fraction(centres[near] + shift, size)
        result[near] = filled / np.float32(parts**3)
        return result.reshape(grid.shape)

    def _part_fraction(self, centres: Array, size: float) -> Singles:
        """Part inside of cubes of an edge [m], shape (n,)."""
        distance = self.distance(centres)
        fraction = (distance < 0.0).astype(np.float32)
        crossed = np.flatnonzero(np.abs(distance) < _HALF_DIAGONAL * size)
        if len(crossed):
            step = 0.5 * self.voxel_m * np.eye(3)
            slope = np.stack(
                [self.distance(centres[crossed] + each) - self.distance(centres[crossed] - each) for each in step], -1
            )
            length = np.linalg.norm(slope, axis=1, keepdims=True)
            normal = np.where(length > 0.0, slope / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
            fraction[crossed] = cube_fraction(distance[crossed] / size, normal)
        return fraction

    def _solid_at(self, points: Floats) -> Singles:
        """Share of all layers at points [m], shape (n, 3)."""
        return np.concatenate([_interpolated(self.solid, self._index(points[p])) for p in _parts(len(points))])

    def _index(self, points: Floats) -> Array:
        """Indices [voxel] of points [m], shape (3, n)."""
        return np.asarray(self.start[:, None] + self.turn @ points.T)


def _plane_share() -> tuple[Array, Array]:
    """Share behind a plane, rising, and its depth below the plane [deviations]."""
    from scipy.special import ndtr

    depth = np.linspace(-_FARTHEST, _FARTHEST, 801)
    return ndtr(depth) + depth * np.exp(-0.5 * depth**2) / np.sqrt(2.0 * np.pi), depth


def _interpolated(values: Singles, at: Array) -> Singles:
    """Trilinear interpolation at indices, shape (3, n)."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(values, at, order=1, mode="nearest", output=np.float32))


def _parts(count: int) -> list[slice]:
    """Slices of points that fit the processor's cache."""
    return [slice(k, k + _POINTS_AT_ONCE) for k in range(0, max(count, 1), _POINTS_AT_ONCE)]
