"""Labels of a tooth in a site's frame, and voxels made of them by sub-samples."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import ceil

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.placement import Placement
from meshes.tooth.label_image import EMPTY
from meshes.tooth.layers import LAYER_DENSITY_KG_M3, PRIORITY, TOOTH_LAYERS
from meshes.voxels.grid import Grid
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["MOST_SAMPLES", "PlacedLabels", "resampled"]

MOST_SAMPLES = 6
"""Sub-samples along the edge of a voxel, at most: the 216 of a voxel still fit a byte."""
_SLAB = 8
_THREADS = 2
_DENSITY = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.uint16)


@dataclass(frozen=True, eq=False)
class PlacedLabels:
    """A layer image with its place in the site frame.

    Attributes
    ----------
    layer
        Layer index, `EMPTY` outside and all along the border, uint8, shape (nx, ny, nz), C-contiguous.
    spacing
        Voxel sizes [m], shape (3,).
    first_m
        Centre of voxel (0, 0, 0) in the file's frame [m], shape (3,).
    origin, rotation
        Site's origin [m] from there, and its axes as columns in the file's frame.
    """

    layer: NDArray[np.uint8]
    spacing: NDArray[np.float64]
    first_m: NDArray[np.float64]
    origin: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def on_plane(self, x: float, y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Layer at the points of a plane of the site frame, shape (ny, nz); a margin of empty voxels is `EMPTY`."""
        number = np.zeros((len(y), len(z)), dtype=np.int32)
        for axis, count in enumerate(self.layer.shape):
            scale = self.rotation[axis] / self.spacing[axis]
            start = float(self.origin[axis] / self.spacing[axis] + scale[0] * x) + 0.5
            index = (start + scale[1] * y).astype(np.float32)[:, None] + (scale[2] * z).astype(np.float32)
            np.clip(index, 0, count - 1, out=index)
            number *= count
            number += index.astype(np.int32)  # rounds to the nearest, half of a voxel being added above
        return self.layer.ravel()[number]

    @property
    def placement(self) -> Placement:
        """Where the site lies in the file."""
        return Placement(1e3 * (self.first_m + self.origin), self.rotation)

    def around(
        self, corners: NDArray[np.float64], reach: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
        """Labels of the voxels in a box [m] of the site frame and `reach` voxels beyond, and where a point is in them.

        Returns
        -------
        A copy of the labels; ``start``, shape (3,), and ``turn``, shape (3, 3), of a point's index [voxel] among them,
        ``start + turn @ point``.
        """
        turn, start = self.rotation / self.spacing[:, None], self.origin / self.spacing
        at = start + np.array(list(product(*np.array(corners).T))) @ turn.T
        low = np.clip(np.floor(at.min(axis=0)).astype(int) - reach, 0, np.array(self.layer.shape) - 1)
        high = np.clip(np.ceil(at.max(axis=0)).astype(int) + reach + 1, low + 1, self.layer.shape)
        kept = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        return self.layer[kept].copy(), start - low, turn

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Lowest and highest corner [m] of the tooth in the site frame, shape (2, 3)."""
        steps = [max(n // 160, 1) for n in self.layer.shape]
        index = np.argwhere(self.layer[:: steps[0], :: steps[1], :: steps[2]] != EMPTY) * steps
        points = (index * self.spacing - self.origin) @ self.rotation
        reach = float(np.linalg.norm(steps * self.spacing))
        return np.stack([points.min(axis=0) - reach, points.max(axis=0) + reach])


def resampled(
    placed: PlacedLabels,
    corners: NDArray[np.float64],
    size: float,
    *,
    most_samples: int = MOST_SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> VoxelVolume:
    """Voxels of edge `size` [m] on whole multiples of it between two corners [m], cropped to the tooth.

    Fractions and layers come from sub-samples no farther apart than the image's voxels, at most `most_samples` along an
    axis: the fraction is the part of them in any layer, the layer the commonest, the first of `PRIORITY` of equal ones.

    Raises
    ------
    InputError
        If the tooth has nothing between the corners.
    """
    from scipy.ndimage import find_objects

    first = np.floor(corners[0] / size).astype(int).tolist()
    count = (np.ceil(corners[1] / size).astype(int) - first).tolist()
    grid = Grid(size, (first[0], first[1], first[2]), (count[0], count[1], count[2]))
    parts = min(max(ceil(size / float(placed.spacing.min()) - 1e-6), 1), most_samples)
    fraction, layer = np.zeros(grid.shape, np.uint8), np.zeros(grid.shape, np.uint8)
    preference = [TOOTH_LAYERS.index(name) for name in PRIORITY if (placed.layer == TOOTH_LAYERS.index(name)).any()]

    def fill(start: int) -> None:
        stop = min(start + _SLAB, grid.shape[0])
        held = _parts_by_layer(placed, grid.slab(start, stop), parts, preference)[..., : len(preference)]
        fraction[start:stop] = np.rint(held.sum(axis=3, dtype=np.int32) * (FULL / parts**3))
        layer[start:stop] = np.array(preference, dtype=np.uint8)[np.argmax(held, axis=3)] * (fraction[start:stop] > 0)

    with ThreadPoolExecutor(_THREADS) as pool:
        starts = range(0, grid.shape[0], _SLAB)
        for done, _ in enumerate(pool.map(fill, starts), start=1):
            if progress is not None:
                progress(done / len(starts))
    if not fraction.any():
        raise InputError(
            "region", "meet the tooth", "one without any of it", "move the tool to the tooth, or set anatomy.site"
        )
    (crop,) = find_objects((fraction > 0).view(np.uint8))
    origin = (np.array(grid.first) + [s.start for s in crop]) * size
    layer, fraction = np.ascontiguousarray(layer[crop]), np.ascontiguousarray(fraction[crop])
    density = _DENSITY[layer] * (fraction > 0)
    return VoxelVolume(origin, size, fraction, layer, density, TOOTH_LAYERS, placed.placement)


def _parts_by_layer(placed: PlacedLabels, grid: Grid, parts: int, layers: Sequence[int]) -> NDArray[np.uint8]:
    """Sub-samples of each voxel in each of up to eight layers, shape (nx, ny, nz, 8).

    Eight counters of a byte share a word, so one sum counts all layers; `parts`³ fits a byte.
    """
    counter = np.zeros(EMPTY + 1, dtype=np.uint64)
    counter[list(layers)] = np.uint64(1) << (np.uint64(8) * np.arange(len(layers), dtype=np.uint64))
    x, y, z = (
        ((np.arange(n * parts) + 0.5) / parts + f) * grid.spacing_m for f, n in zip(grid.first, grid.shape, strict=True)
    )
    held = np.zeros(grid.shape, dtype="<u8")
    for k, height in enumerate(x):
        found = counter[placed.on_plane(height, y, z)]
        for i, j in np.ndindex(parts, parts):
            held[k // parts] += found[i::parts, j::parts]
    return held.view(np.uint8).reshape(*grid.shape, 8)
