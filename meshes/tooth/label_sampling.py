"""Label image of a tooth in a site's frame, and conversion of the labels to voxels.

Labels are converted to voxels by `resampled` or by `LabelShares`.

`resampled` counts the labels at sub-samples of each voxel, which is fast for a whole tooth.
`LabelShares` defines continuous functions of position, which do not depend on the voxel grid. The
mask of each layer is smoothed by the kernel of `meshes.voxels.label_shares`, with a standard
deviation of 1.5 voxels, and then interpolated. The interpolated value is called the share of the
layer. For labels of planes and balls, the position of the surface has an RMS error of 0.08 voxels
and no bias. A layer with a thickness of two voxels becomes thicker by 0.2 voxels on each side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from math import ceil

import numpy as np

from meshes.base.arrays import Array, Bytes, Floats, Singles, lattice
from meshes.base.errors import InputError
from meshes.base.grid import Grid
from meshes.base.placement import Placement
from meshes.tooth.layers import (
    EMPTY,
    LAYER_DENSITY_KG_M3,
    PRIORITY,
    TOOTH_LAYERS,
    in_chunks,
)
from meshes.voxels.distances import cube_fraction
from meshes.voxels.label_shares import depth_of_share, spread_labels
from meshes.voxels.volume import FULL, VoxelVolume

MOST_SAMPLES = 6
"""Largest number of sub-samples along the edge of a voxel.

With six, the number of sub-samples per voxel is 216, which fits in a byte.
"""
SPREAD = 1.5
"""Standard deviation of the Gaussian in the smoothing kernel [voxel].

With 1.0, planes have a position error of 0.10 voxels (RMS). With 2.0, thin layers have a larger
error.
"""
REACH = 8
"""Width [voxel] of the margin around a region. Labels in the margin influence shares in the region.

The width is four standard deviations of the smoothing, plus one voxel for the Laplacian and one for
interpolation.
"""
_SLAB = 8
"""Number of voxel planes that a thread fills at once.

The number is small, so that progress is reported often.
"""
_THREADS = 2
"""Number of threads. NumPy releases the interpreter lock in most of the work."""
_SURELY = 0.49
"""If a share differs from one half by more than this value, no surface lies within one voxel."""
_HALF_DIAGONAL = 0.5 * 3.0**0.5
_DENSITY_KG_M3 = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.uint16)


@dataclass(frozen=True, eq=False)
class PlacedLabels:
    """Label image of a tooth with its position in the site frame.

    Attributes
    ----------
    layer
        Layer index of each voxel, uint8, shape (nx, ny, nz), C-contiguous. The value is `EMPTY`
        outside the tooth and at the border of the array.
    spacing
        Voxel sizes [m], shape (3,).
    first_m
        Centre [m], shape (3,), of voxel (0, 0, 0) in the file's frame.
    origin, rotation
        Origin of the site relative to `first_m` [m], and matrix whose columns are the axes of the
        site in the file's frame.
    """

    layer: Bytes
    spacing: Array
    first_m: Array
    origin: Array
    rotation: Array

    def on_plane(self, x: float, y: Array, z: Array) -> Bytes:
        """Return the layer indices, shape (ny, nz), at the site-frame points (x, y[j], z[k])."""
        number = np.zeros((len(y), len(z)), dtype=np.int32)
        for axis, count in enumerate(self.layer.shape):
            scale = self.rotation[axis] / self.spacing[axis]
            start = float(self.origin[axis] / self.spacing[axis] + scale[0] * x) + 0.5
            index = (start + scale[1] * y).astype(np.float32)[:, None] + (scale[2] * z).astype(
                np.float32
            )
            np.clip(index, 0, count - 1, out=index)
            number *= count
            # rounds to the nearest voxel, because half a voxel is added above
            number += index.astype(np.int32)
        return self.layer.ravel()[number]

    @property
    def placement(self) -> Placement:
        """Placement of the site frame in the frame of the file."""
        return Placement(1e3 * (self.first_m + self.origin), self.rotation)

    def around(self, corners: Array, reach: int) -> tuple[Bytes, Array, Array]:
        """Return the labels in and near a box [m] of the site frame, and the map to array indices.

        The labels extend `reach` voxels beyond the box.

        Returns
        -------
        Copy of the labels; vector ``start``, shape (3,); matrix ``turn``, shape (3, 3). A point of
        the site frame [m] has the index ``start + turn @ point`` [voxel] in the copy.
        """
        turn = self.rotation / self.spacing[:, None]
        start = self.origin / self.spacing
        at = start + np.array(list(product(*np.array(corners).T))) @ turn.T
        low = np.clip(
            np.floor(at.min(axis=0)).astype(int) - reach, 0, np.array(self.layer.shape) - 1
        )
        high = np.clip(np.ceil(at.max(axis=0)).astype(int) + reach + 1, low + 1, self.layer.shape)
        kept = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        return self.layer[kept].copy(), start - low, turn

    @cached_property
    def corners(self) -> Array:
        """Smallest and largest coordinates [m] of the tooth in the site frame, shape (2, 3)."""
        # About 160 planes per axis are enough, because the box is extended by the distance of the
        # planes.
        steps = [max(n // 160, 1) for n in self.layer.shape]
        index = np.argwhere(self.layer[:: steps[0], :: steps[1], :: steps[2]] != EMPTY) * steps
        points = (index * self.spacing - self.origin) @ self.rotation
        reach = float(np.linalg.norm(steps * self.spacing))
        return np.stack([points.min(axis=0) - reach, points.max(axis=0) + reach])


def resampled(
    placed: PlacedLabels,
    size: float,
    *,
    most_samples: int = MOST_SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> VoxelVolume:
    """Convert the whole tooth to voxels with the edge `size` [m], and crop the array to the tooth.

    The grid lines lie at integer multiples of the voxel edge.

    Fractions and layers are computed from sub-samples. Along each axis, a voxel has enough
    sub-samples for a distance of at most one image voxel between them, but no more than
    `most_samples`. The bone fraction is the share of the sub-samples that lie in any layer. A voxel
    gets the most frequent layer of its sub-samples. If several layers are equally frequent, the
    layer that comes first in `PRIORITY` is used.

    Raises
    ------
    InputError
        If the tooth is so thin that it contains no sub-sample.
    """
    from scipy.ndimage import find_objects

    corners = placed.corners
    first = np.floor(corners[0] / size).astype(int).tolist()
    count = (np.ceil(corners[1] / size).astype(int) - first).tolist()
    grid = Grid(size, (first[0], first[1], first[2]), (count[0], count[1], count[2]))
    # The tolerance avoids twice as many sub-samples because of rounding errors of equal sizes.
    parts = min(max(ceil(size / float(placed.spacing.min()) - 1e-6), 1), most_samples)
    fraction = np.zeros(grid.shape, np.uint8)
    layer = np.zeros(grid.shape, np.uint8)
    preference = [
        TOOTH_LAYERS.index(name)
        for name in PRIORITY
        if (placed.layer == TOOTH_LAYERS.index(name)).any()
    ]

    def fill(start: int) -> None:
        """Compute fraction and layer of the slab of voxels that begins at an index."""
        stop = min(start + _SLAB, grid.shape[0])
        held = _parts_by_layer(placed, grid.slab(start, stop), parts, preference)[
            ..., : len(preference)
        ]
        fraction[start:stop] = np.rint(held.sum(axis=3, dtype=np.int32) * (FULL / parts**3))
        layer[start:stop] = np.array(preference, dtype=np.uint8)[np.argmax(held, axis=3)] * (
            fraction[start:stop] > 0
        )

    with ThreadPoolExecutor(_THREADS) as pool:
        starts = range(0, grid.shape[0], _SLAB)
        for done, _ in enumerate(pool.map(fill, starts), start=1):
            if progress is not None:
                progress(done / len(starts))
    if not fraction.any():
        raise InputError(
            "labels",
            "be thick enough for the voxels",
            f"a tooth thinner than voxels of {1000.0 * size:g} mm",
            "use smaller voxels",
        )
    (crop,) = find_objects((fraction > 0).view(np.uint8))
    origin = (np.array(grid.first) + [s.start for s in crop]) * size
    layer = np.ascontiguousarray(layer[crop])
    fraction = np.ascontiguousarray(fraction[crop])
    density = _DENSITY_KG_M3[layer] * (fraction > 0)
    return VoxelVolume(origin, size, fraction, layer, density, TOOTH_LAYERS, placed.placement)


def _parts_by_layer(placed: PlacedLabels, grid: Grid, parts: int, layers: Sequence[int]) -> Bytes:
    """Count the sub-samples of each voxel by layer; the counts have the shape (nx, ny, nz, 8).

    At most eight layers are possible. A 64-bit word consists of eight one-byte counters, so one
    addition counts all layers. The number of sub-samples, `parts`³, must fit in a byte.
    """
    counter = np.zeros(EMPTY + 1, dtype=np.uint64)
    counter[list(layers)] = np.uint64(1) << (np.uint64(8) * np.arange(len(layers), dtype=np.uint64))
    x, y, z = (
        ((np.arange(n * parts) + 0.5) / parts + f) * grid.spacing_m
        for f, n in zip(grid.first, grid.shape, strict=True)
    )
    held = np.zeros(grid.shape, dtype="<u8")
    for k, height in enumerate(x):
        found = counter[placed.on_plane(height, y, z)]
        for i, j in np.ndindex(parts, parts):
            held[k // parts] += found[i::parts, j::parts]
    return held.view(np.uint8).reshape(*grid.shape, 8)


@dataclass(frozen=True, eq=False)
class LabelShares:
    """Share of each layer at any point of a box.

    The share of a layer is its smoothed and interpolated mask.

    Attributes
    ----------
    layers
        Indices of the layers in the box, uint8. If two layers have equal shares at a point, the
        point belongs to the layer that is listed first.
    shares
        One array of shares for each layer, float32, shape (nx, ny, nz).
    solid
        Sum of the shares of all layers.
    start, turn
        Vector and matrix that convert a point of the site frame [m] to an index [voxel]: ``start +
        turn @ point``.
    deviation_m
        Standard deviation [m] of the Gaussian kernel that smooths the masks.
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
        """Compute the shares of layers by smoothing `labels`, shape (nx, ny, nz).

        `voxel_m` contains the sides of a voxel of `labels` [m], shape (3,).
        """
        deviation = SPREAD * float(voxel_m.max())
        there = [layer for layer in layers if (labels == layer).any()]

        def share(layer: int) -> Singles:
            return spread_labels((labels == layer).astype(np.float32), deviation / voxel_m)

        with ThreadPoolExecutor(_THREADS) as pool:
            shares = tuple(pool.map(share, there))
        solid = np.asarray(sum(shares, start=np.zeros(labels.shape, np.float32)))
        return cls(
            np.array(there, np.uint8), shares, solid, start, turn, deviation, float(voxel_m.min())
        )

    def sample(self, grid: Grid) -> tuple[Singles, Singles]:
        """Compute the solid fraction and the depth of each voxel of a grid.

        See `meshes.shapes.anatomy.GridSampler`.

        The returned depth is zero, because `classify` does not use the depth.
        """
        return self.fraction(grid), np.zeros(grid.shape, dtype=np.float32)

    def classify(self, points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return the layer and the density [kg/m3] at given points.

        See `meshes.shapes.anatomy.Classify`.
        """
        layer = self.layer(points)
        return layer, _DENSITY_KG_M3[layer].astype(np.float32)

    def layer(self, points: Floats) -> Bytes:
        """Return the layer with the largest share at points [m], shape (n, 3)."""
        if len(self.layers) < 2:
            return np.full(len(points), self.layers[0] if len(self.layers) else 0, np.uint8)

        def largest(part: Floats) -> Bytes:
            shares = [self._interpolated(share, part) for share in self.shares]
            return self.layers[np.argmax(shares, axis=0)]

        return in_chunks(largest, points)

    def distance(self, points: Floats) -> Array:
        """Compute the signed distance [m] of points [m], shape (n, 3), from the tooth's surface.

        At points whose distance from the surface exceeds `deviation_m` (standard deviation of the
        smoothing), the magnitude of the result is only a lower bound of the distance.
        """
        return -self.deviation_m * depth_of_share(self._solid_at(points))

    def fraction(self, grid: Grid) -> Singles:
        """Compute the fraction of each voxel's volume that lies inside the surface.

        A voxel is divided into cubes that are at most as large as a voxel of the label image. In
        each cube, the surface is treated as a plane.
        """
        from scipy.ndimage import binary_dilation

        axes = [
            (np.arange(n) + f + 0.5) * grid.spacing_m
            for f, n in zip(grid.first, grid.shape, strict=True)
        ]
        centres = lattice(*axes)
        share = self._solid_at(centres)
        result = (share > 0.5).astype(np.float32)
        side = result.reshape(grid.shape) > 0.5
        mixed = (np.abs(share - 0.5) < _SURELY).reshape(grid.shape)
        # between neighbours on different sides there is a surface, also around a thin region
        for axis in range(3):
            low, high = ((slice(None),) * axis + (part,) for part in (slice(0, -1), slice(1, None)))
            mixed[low] |= side[low] != side[high]
        near = np.flatnonzero(binary_dilation(mixed, np.ones((3, 3, 3))))
        # The tolerance avoids twice as many parts because of rounding errors of equal sizes.
        parts = max(ceil(grid.spacing_m / self.voxel_m - 1e-6), 1)
        size = grid.spacing_m / parts
        within = (np.arange(parts) - 0.5 * (parts - 1)) * size
        filled = np.zeros(len(near), dtype=np.float32)
        for shift in product(within, repeat=3):
            filled += self._part_fraction(centres[near] + shift, size)
        result[near] = filled / np.float32(parts**3)
        return result.reshape(grid.shape)

    def _part_fraction(self, centres: Array, size: float) -> Singles:
        """Compute the fraction, shape (n,), of each cube that lies inside the surface."""
        distance = self.distance(centres)
        fraction = (distance < 0.0).astype(np.float32)
        crossed = np.flatnonzero(np.abs(distance) < _HALF_DIAGONAL * size)
        if len(crossed):
            step = 0.5 * self.voxel_m * np.eye(3)
            slope = np.stack(
                [
                    self.distance(centres[crossed] + each) - self.distance(centres[crossed] - each)
                    for each in step
                ],
                -1,
            )
            # In the middle between two surfaces the slope is zero. Any direction then gives nearly
            # the same fraction.
            length = np.linalg.norm(slope, axis=1, keepdims=True)
            normal = np.where(
                length > 0.0, slope / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0])
            )
            fraction[crossed] = cube_fraction(distance[crossed] / size, normal)
        return fraction

    def _solid_at(self, points: Floats) -> Singles:
        """Compute the sum of the shares of all layers at points [m], shape (n, 3)."""
        return in_chunks(partial(self._interpolated, self.solid), points)

    def _interpolated(self, values: Singles, points: Floats) -> Singles:
        """Interpolate values of the voxels linearly at points [m], shape (n, 3)."""
        from scipy.ndimage import map_coordinates

        at = self.start[:, None] + self.turn @ points.T
        return np.asarray(map_coordinates(values, at, order=1, mode="nearest", output=np.float32))
