"""Conversion of an anatomy to voxels in a region of the site frame.

Each voxel has a sub-voxel bone fraction, a layer and a density.

A signed distance is first evaluated at the centres of blocks of 8 x 8 x 8 voxels. If the centre of
a block is farther from the surface than half the block's diagonal, the block is completely empty or
solid, because a signed distance is 1-Lipschitz. Only blocks that the surface may cross are
evaluated voxel by voxel. In a solid block, the density is interpolated trilinearly between the
corners, if all corners of this block and of the neighbouring blocks have the same layer.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints, Singles, lattice
from meshes.base.errors import InputError, require_positive
from meshes.base.grid import BLOCK, Grid
from meshes.shapes.anatomy import Anatomy, GridSampler
from meshes.shapes.sdf import Shape
from meshes.voxels.distances import (
    INSIDE,
    OUTSIDE,
    LayerAt,
    carried_beyond,
    cube_fraction,
    layer_boundary,
    surface_of_fractions,
    surface_steps,
)
from meshes.voxels.mesh_sampling import refined
from meshes.voxels.volume import FULL, VoxelVolume

_BLOCKS_AT_ONCE = 256
"""Number of blocks evaluated at once.

The coordinates of the 131,072 voxels in these blocks take 1.5 MB, which fits in the processor's
cache.
"""
_WIDEST_INTERPOLATION_M = 1.0e-3
"""Largest edge [m] of a block in which the density is interpolated.

Within a layer, densities vary smoothly over a millimetre.
"""
_HALF_DIAGONAL = 0.5 * math.sqrt(3.0)
_SHARP_BEND = 0.1
"""Change of the distance's slope in a voxel above which the voxel is treated as creased.

A crease is an edge or corner of the solid. With the values 0.03 and 0.1, the volume of a block with
sharp edges is 0.04 % too large. With 0.3, the volume is 0.08 % too large, and with 1, 0.17 %.
"""
_PARTS = 4
"""Number of parts into which an edge of a voxel with a crease is divided.

For a block with sharp edges, the volume error is 0.07 % with 2 parts, and 0.04 % with 8 parts.
"""
_LOCAL = lattice(*[np.arange(BLOCK)] * 3)


class VoxelArrays(NamedTuple):
    """Arrays for a `VoxelVolume` that is being filled, on a grid of whole blocks.

    All arrays have the shape of the grid.
    """

    fraction: Bytes
    layer: Bytes
    density: NDArray[np.uint16]
    surface: Bytes

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> VoxelArrays:
        """Return arrays without bone."""
        bytes_, words = (np.zeros(shape, dtype) for dtype in (np.uint8, np.uint16))
        return cls(bytes_, np.zeros_like(bytes_), words, np.full(shape, OUTSIDE, np.uint8))

    def slab(self, start: int, stop: int) -> VoxelArrays:
        """Return views of the arrays for the x indices `start` to `stop` - 1."""
        return VoxelArrays._make(each[start:stop] for each in self)


def voxel_fraction(
    shape: Shape,
    centres: Singles,
    distance: Singles,
    spacing_m: float,
    *,
    split_creases: bool = True,
) -> Singles:
    """Compute the fraction of each voxel inside a shape.

    In each voxel, the surface is approximated by a plane.

    If the distance has a crease within a voxel (an edge or corner), the voxel is divided into 4 x 4
    x 4 parts, each with its own plane.

    Parameters
    ----------
    centres
        Voxel centres [m], shape (n, 3).
    distance
        Signed distance [m], shape (n,), of the centres from the shape's surface.
    spacing_m
        Edge of a voxel [m].

    Returns
    -------
    Fractions from 0 to 1, shape (n,). The plane's normal is computed from central differences of
    the distance, taken over half a voxel.
    """
    fraction = (distance < 0.0).astype(np.float32)
    crossed = np.flatnonzero(np.abs(distance) < _HALF_DIAGONAL * spacing_m)
    if len(crossed) == 0:
        return fraction
    points = centres[crossed]
    middle = distance[crossed]
    # The two points of a difference are half a voxel apart, so they lie within the voxel.
    step = np.float32(0.25 * spacing_m)
    gradient = np.empty((len(crossed), 3), dtype=np.float32)
    bend = np.zeros(len(crossed), dtype=np.float32)
    for axis in range(3):
        shift = step * np.eye(3, dtype=np.float32)[axis]
        forward, backward = (
            shape.distance(np.asfortranarray(points + sign * shift)) for sign in (1, -1)
        )
        gradient[:, axis] = (forward - backward) / (2.0 * step)
        bend = np.maximum(bend, np.abs(forward + backward - 2.0 * middle))
    # If the slope is zero, as in the middle between two surfaces, its direction is only a rounding
    # error, so z is used.
    slope = np.maximum(np.linalg.norm(gradient, axis=1), np.float32(1e-3))
    normal = np.where(
        slope[:, None] > 2e-3,
        gradient / slope[:, None],
        np.array([0.0, 0.0, 1.0], dtype=np.float32),
    )
    fraction[crossed] = cube_fraction(middle / (slope * np.float32(spacing_m)), normal)
    creased = crossed[bend > _SHARP_BEND * step]
    if split_creases and len(creased):
        fraction[creased] = _split_fraction(shape, centres[creased], spacing_m)
    return fraction


def _split_fraction(shape: Shape, centres: Singles, spacing_m: float) -> Singles:
    """Compute the fraction, shape (n,), of each voxel inside a shape from 4 x 4 x 4 parts."""
    offsets = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5).astype(np.float32) * np.float32(spacing_m)
    local = lattice(offsets, offsets, offsets)
    points = np.asfortranarray((centres[:, None, :] + local).reshape(-1, 3))
    parts = voxel_fraction(
        shape, points, shape.distance(points), spacing_m / _PARTS, split_creases=False
    )
    return parts.reshape(len(centres), -1).mean(axis=1)


def fill_from_shape(anatomy: Anatomy, grid: Grid, out: VoxelArrays) -> None:
    """Fill `out` by evaluating the anatomy's signed distance on a grid of whole blocks."""
    firsts = grid.block_firsts()
    blocks = [_by_blocks(array) for array in out]
    counts = blocks[0].shape[:3]
    distance = anatomy.shape.distance(centres_of(firsts, grid.spacing_m, 0.5 * BLOCK))
    distance = distance.reshape(counts)
    reach = np.float32(_HALF_DIAGONAL * BLOCK * grid.spacing_m)
    solid = distance <= -reach
    mixed = ~solid & (distance < reach)
    if solid.any():
        same, layers, densities = _uniform_blocks(anatomy, grid)
        plain = same & solid & (not anatomy.thin_layers)
        blocks[0][solid] = FULL
        blocks[1][plain] = layers[plain][:, None, None, None]
        blocks[2][plain] = np.rint(_interpolated(densities, plain))
        blocks[3][solid] = INSIDE
        mixed |= solid & ~plain
    left = np.flatnonzero(mixed)
    for start in range(0, len(left), _BLOCKS_AT_ONCE):
        chosen = left[start : start + _BLOCKS_AT_ONCE]
        points = centres_of((firsts[chosen, None, :] + _LOCAL).reshape(-1, 3), grid.spacing_m, 0.5)
        depth = anatomy.shape.distance(points)
        fraction = voxel_fraction(anatomy.shape, points, depth, grid.spacing_m)
        layer, density = anatomy.classify(points, -depth)
        where = np.unravel_index(chosen, counts)
        surface = surface_steps(depth / np.float32(grid.spacing_m))
        # also outside the surface, because points between voxel centres use the two sides
        present = surface < OUTSIDE
        filled = np.rint(fraction * FULL), layer * present, np.rint(density) * present, surface
        for block, values in zip(blocks, filled, strict=True):
            block[where] = values.reshape(-1, BLOCK, BLOCK, BLOCK)


def _uniform_blocks(anatomy: Anatomy, grid: Grid) -> tuple[Flags, Bytes, Floats]:
    """Find the blocks that lie, with their neighbours, in one layer.

    A block is flagged if all corners of the block and of the neighbouring blocks have the same
    layer.

    Returns
    -------
    Flags and layers of the blocks, shape (bx, by, bz); densities [kg/m3] at the corners of the
    blocks, shape (bx + 1, by + 1, bz + 1).
    """
    axes = [
        np.arange(f - BLOCK, e + BLOCK + 1, BLOCK)
        for f, e in zip(grid.first, grid.last, strict=True)
    ]
    size = [len(axis) for axis in axes]
    points = centres_of(lattice(*axes), grid.spacing_m, 0.0)
    layer, density = anatomy.classify(points, -anatomy.shape.distance(points))
    layer = layer.reshape(size)
    density = density.reshape(size)
    same = _over_windows(np.maximum, layer) == _over_windows(np.minimum, layer)
    same &= BLOCK * grid.spacing_m <= _WIDEST_INTERPOLATION_M
    return same, layer[1:-2, 1:-2, 1:-2], density[1:-1, 1:-1, 1:-1]


def _over_windows(combine: np.ufunc, values: Bytes) -> Bytes:
    """Combine the values in each window of 4 x 4 x 4 lattice points by a function such as minimum.

    A window contains the corners of a block and of the neighbouring blocks.
    """
    windows = np.lib.stride_tricks.sliding_window_view(values, (4, 4, 4))
    return np.asarray(combine.reduce(windows, axis=(3, 4, 5)), dtype=np.uint8)


def _interpolated(corners: Floats, chosen: Flags) -> Singles:
    """Interpolate corner values trilinearly to the voxels of chosen blocks, shape (n, 8, 8, 8)."""
    bx, by, bz = np.nonzero(chosen)
    values = np.empty((len(bx), 2, 2, 2), dtype=np.float32)
    for i, j, k in np.ndindex(2, 2, 2):
        values[:, i, j, k] = corners[bx + i, by + j, bz + k]
    return refined(values, BLOCK, axes=(1, 2, 3))


def centres_of(index: Ints, spacing_m: float, shift: float) -> Singles:
    """Return the points ``(index + shift) * spacing_m`` [m], shape (n, 3).

    The array is float32 and stored in column order.
    """
    return (index.T.astype(np.float32) + np.float32(shift)).T * np.float32(spacing_m)


def _by_blocks(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a view, shape (bx, by, bz, 8, 8, 8), of an array that consists of whole blocks."""
    nx, ny, nz = (n // BLOCK for n in array.shape)
    return array.reshape(nx, BLOCK, ny, BLOCK, nz, BLOCK).transpose(0, 2, 4, 1, 3, 5)


Region = tuple[Sequence[float] | Array, Sequence[float] | Array]

AROUND_VOXELS = 2
"""Width of the region around the bone in which the surface distance is stored [voxel]."""
_ROUNDING = 1e-6
"""Largest distance [voxel] of a corner from a grid line that counts as a rounding error."""
_MAXIMUM_THREADS = 4
"""Largest number of threads. Each thread needs memory for its points and distances."""
_SAMPLED_BLOCKS = 4
"""Number of blocks along x per call of a sampler.

More than one block is sampled at once, because each call searches all triangles.
"""


def voxelise(
    anatomy: Anatomy,
    *,
    spacing_m: float,
    region_m: Region | None = None,
    minus: Shape | None = None,
    progress: Callable[[float], None] | None = None,
) -> VoxelVolume:
    """Convert an anatomy to voxels in the site frame.

    Grid lines lie at integer multiples of the spacing, so the content of a voxel does not depend on
    the region. If the surface crosses a voxel, the bone fraction is the fraction of the voxel
    behind a plane that approximates the surface. The volume error is of second order in the
    spacing. In voxels in which two surfaces cross, the error is of first order.

    Parameters
    ----------
    anatomy
        Anatomy to convert.
    spacing_m
        Edge of a voxel [m].
    region_m
        Lowest and highest coordinates [m] of the region. The region is extended to whole voxels. If
        None, the grid covers the anatomy's bounding box and a margin of two voxels. The surface
        distance is also stored in the margin.
    minus
        Solid in the site frame, such as a pilot hole, that is subtracted with sub-voxel accuracy.
        The subtraction does not change the layers.
    progress
        Function that is called with the finished fraction, 0 to 1, in the calling thread.

    Raises
    ------
    InputError
        If the spacing or region cannot be used.
    """
    spacing = require_positive("spacing_m", spacing_m, "use about 1e-4 (0.1 mm)")
    grid = _grid(anatomy, spacing, region_m)
    blocked = grid.blocked()
    arrays = VoxelArrays.empty(blocked.shape)
    depth = np.zeros(blocked.shape if anatomy.sample is not None else (0, 0, 0), dtype=np.float32)
    thickness = BLOCK if anatomy.sample is None else _SAMPLED_BLOCKS * BLOCK
    starts = range(0, blocked.shape[0], thickness)

    def fill(start: int) -> None:
        """Fill the slab that begins at a row of blocks."""
        stop = min(start + thickness, blocked.shape[0])
        slab = blocked.slab(start, stop)
        part = arrays.slab(start, stop)
        if anatomy.sample is None:
            fill_from_shape(anatomy, slab, part)
        else:
            depth[start:stop] = _fill_from_samples(anatomy, anatomy.sample, slab, part)
        if minus is not None:
            _take_out(minus, slab, part)

    with ThreadPoolExecutor(min(_MAXIMUM_THREADS, os.cpu_count() or 1)) as pool:
        for done, _ in enumerate(pool.map(fill, starts), start=1):
            if progress is not None:
                progress(done / len(starts))
    kept = tuple(
        slice(f - b, f - b + n)
        for f, b, n in zip(grid.first, blocked.first, grid.shape, strict=True)
    )
    cut = VoxelArrays._make(np.ascontiguousarray(each[kept]) for each in arrays)
    fraction, layer, density, surface = cut
    known = surface < OUTSIDE
    if anatomy.sample is not None:
        surface = surface_of_fractions(fraction)
        layer, density, known = carried_beyond(fraction, surface, layer, density)
    boundary = layer_boundary(layer, known, _layer_at(anatomy, grid, depth[kept]))
    return VoxelVolume(
        grid.origin_m,
        spacing,
        fraction,
        layer,
        density,
        anatomy.layer_names,
        anatomy.placement,
        surface,
        boundary,
    )


def _layer_at(anatomy: Anatomy, grid: Grid, depth: Singles) -> LayerAt:
    """Return a function that gives the anatomy's layer at points in voxel coordinates.

    If the anatomy has a sampler, the depth of a point is interpolated from the sampled array
    `depth`.
    """
    first = np.array(grid.first, dtype=np.float32)
    spacing = np.float32(grid.spacing_m)

    def layer_at(points: Singles) -> Bytes:
        """Return the layer, shape (n,), at points in voxels relative to the grid's first corner.

        The points have the shape (n, 3).
        """
        at = np.asfortranarray((points + first) * spacing)
        if anatomy.sample is None:
            return anatomy.classify(at, -anatomy.shape.distance(at))[0]
        from scipy.ndimage import map_coordinates

        between = map_coordinates(depth, points.T - np.float32(0.5), order=1, mode="nearest")
        return anatomy.classify(at, between)[0]

    return layer_at


def _grid(anatomy: Anatomy, spacing: float, region_m: Region | None) -> Grid:
    """Build the grid for the region or, without a region, for the anatomy's box with a margin.

    The grid lines lie at integer multiples of the spacing.
    """
    around = AROUND_VOXELS * spacing
    lower = np.array(anatomy.shape.lower_m) - around
    upper = np.array(anatomy.shape.upper_m) + around
    if region_m is not None:
        lower, upper = _corners(region_m)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise InputError(
            "region_m",
            "be given for an unbounded anatomy",
            "none",
            "use the box that the tool reaches",
        )
    first = np.floor(lower / spacing + _ROUNDING).astype(int).tolist()
    last = np.ceil(upper / spacing - _ROUNDING).astype(int).tolist()
    counts = [max(b - a, 1) for a, b in zip(first, last, strict=True)]
    return Grid(spacing, (first[0], first[1], first[2]), (counts[0], counts[1], counts[2]))


def _corners(region_m: Region) -> tuple[Array, Array]:
    corners = np.asarray(region_m, dtype=np.float64)
    if (
        corners.shape != (2, 3)
        or not np.isfinite(corners).all()
        or not (corners[0] < corners[1]).all()
    ):
        raise InputError(
            "region_m",
            "be two finite corners, the first below the second in x, y and z",
            region_m,
            "use for example ((-0.01, -0.01, -0.008), (0.01, 0.01, 0.001))",
        )
    return corners[0], corners[1]


def _fill_from_samples(
    anatomy: Anatomy, sample: GridSampler, grid: Grid, out: VoxelArrays
) -> Singles:
    """Fill `out` by the function `sample`, which computes fraction and depth for a whole grid.

    Return the depth [m] of each voxel.
    """
    fraction, depth = sample(grid)
    out.fraction[...] = np.rint(fraction * FULL)
    index = np.nonzero(out.fraction)
    points = centres_of(np.transpose(index) + grid.first, grid.spacing_m, 0.5)
    layer, density = anatomy.classify(points, depth[index])
    out.layer[index] = layer
    out.density[index] = np.rint(density)
    return depth


def _take_out(minus: Shape, grid: Grid, out: VoxelArrays) -> None:
    """Subtract the solid `minus` from the fraction and the surface distance of each voxel."""
    lower = np.floor(np.array(minus.lower_m) / grid.spacing_m) - np.array(grid.first)
    upper = np.ceil(np.array(minus.upper_m) / grid.spacing_m) - np.array(grid.first)
    if (lower >= grid.shape).any() or (upper <= 0).any():
        return
    low = (np.clip(lower, 0, grid.shape) // BLOCK * BLOCK).astype(int)
    high = (-(-np.clip(upper, 0, grid.shape) // BLOCK) * BLOCK).astype(int)
    part = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    size = high - low
    numbers = lattice(*[np.arange(n) + f for n, f in zip(size, low + grid.first, strict=True)])
    points = centres_of(numbers, grid.spacing_m, 0.5)
    taken = voxel_fraction(minus, points, minus.distance(points), grid.spacing_m).reshape(size)
    out.fraction[part] = np.rint(out.fraction[part] * (1.0 - taken))
    # These points are rounded once, not at each step as above. The traces of all scenes were
    # recorded with these points.
    points = np.asfortranarray((numbers + 0.5) * grid.spacing_m, dtype=np.float32)
    hole = surface_steps(-minus.distance(points).reshape(size) / np.float32(grid.spacing_m))
    out.surface[part] = np.maximum(out.surface[part], hole)
