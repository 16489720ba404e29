"""Conversion of an anatomy to voxels over a region of the site frame.

Each voxel has a sub-voxel bone fraction, a layer and a density.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from meshes.base.arrays import Array, Bytes, Singles, lattice
from meshes.base.errors import InputError, require_positive
from meshes.shapes.anatomy import Anatomy, GridSampler
from meshes.shapes.sdf import Shape
from meshes.voxels.block_sampling import VoxelArrays, centres_of, fill_from_shape, voxel_fraction
from meshes.voxels.distances import (
    OUTSIDE,
    carried_beyond,
    surface_of_fractions,
    surface_steps,
)
from meshes.voxels.grid import BLOCK, Grid
from meshes.voxels.layer_changes import LayerAt, layer_boundary
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["AROUND_VOXELS", "voxelise"]

Region = tuple[Sequence[float] | Array, Sequence[float] | Array]

AROUND_VOXELS = 2
"""Voxels around the bone whose distance to its surface is stored."""
_ROUNDING = 1e-6
_MAXIMUM_THREADS = 4
_SAMPLED_BLOCKS = 4


def voxelise(
    anatomy: Anatomy,
    *,
    spacing_m: float,
    region_m: Region | None = None,
    minus: Shape | None = None,
    progress: Callable[[float], None] | None = None,
) -> VoxelVolume:
    """Convert an anatomy to voxels, in its site frame.

    Grid lines lie on whole multiples of the spacing, so the content of a voxel does not depend on
    the region. A voxel that the surface crosses holds the part of its cube behind the surface's
    tangent plane (an error of second order in the spacing over the volume; where two surfaces cross
    in a voxel, of first order there).

    Parameters
    ----------
    anatomy
        Anatomy to convert.
    spacing_m
        Edge of a voxel [m].
    region_m
        Lowest and highest corner [m] of the box to cover, grown to whole voxels; None: the
        anatomy's bounding box and two voxels around it, as far as the distance to its surface is
        stored.
    minus
        Solid taken out first, in the site frame, sub-voxel too (a pilot hole). Layers stay as they
        were without it.
    progress
        Called with the part done, 0 to 1, from this thread.

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
    fraction = np.ascontiguousarray(arrays.fraction[kept])
    layer = np.ascontiguousarray(arrays.layer[kept])
    density = np.ascontiguousarray(arrays.density[kept])
    surface = np.ascontiguousarray(arrays.surface[kept])
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
    """Return the anatomy's layer at points in voxels of the grid.

    The depth is interpolated where the anatomy samples it.
    """
    first = np.array(grid.first, dtype=np.float32)
    spacing = np.float32(grid.spacing_m)

    def layer_at(points: Singles) -> Bytes:
        """Return the layer, shape (n,), at points in voxels from the grid's first corner.

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
    """Build the grid over the region, or over the anatomy's bounding box and a margin.

    Its lines lie on whole multiples of the spacing.
    """
    around = AROUND_VOXELS * spacing
    lower = np.array(anatomy.shape.lower_m) - around
    upper = np.array(anatomy.shape.upper_m) + around
    if region_m is not None:
        lower, upper = _corners(region_m)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise InputError(
            "region_m",
            "be given for an anatomy without end",
            "None",
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
    """Fill `out` from an anatomy that gives fraction and depth for a whole grid.

    Return the depth [m].
    """
    fraction, depth = sample(grid)
    out.fraction[...] = np.rint(fraction * FULL)
    index = np.nonzero(out.fraction)
    numbers = [i + f for i, f in zip(index, grid.first, strict=True)]
    points = (np.array(numbers, dtype=np.float32) + np.float32(0.5)).T * np.float32(grid.spacing_m)
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
    # Rounded once, not at each step as above: these are the points that the traces of all scenes
    # were recorded with.
    points = np.asfortranarray((numbers + 0.5) * grid.spacing_m, dtype=np.float32)
    hole = surface_steps(-minus.distance(points).reshape(size) / np.float32(grid.spacing_m))
    out.surface[part] = np.maximum(out.surface[part], hole)
