"""Distances of voxels to the bone's surface, in bytes.

They are interpolated between voxel centres. A surface or a change of layer is thus located to
second order in the spacing, not to the nearest voxel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints
from meshes.shapes.plane_cube import cube_fraction
from meshes.voxels.layer_changes import boundary_of_layers
from meshes.voxels.volume import VoxelVolume

__all__ = [
    "INSIDE",
    "OUTSIDE",
    "SURFACE_ZERO",
    "carried_beyond",
    "near_the_surface",
    "surface_of_fractions",
    "surface_steps",
]

SURFACE_STEPS = 63
"""Stored steps per voxel; stored distances reach two voxels."""
SURFACE_ZERO = 128
INSIDE = 2
OUTSIDE = 254
"""Stored surface distance on the surface itself, and two voxels or more inside and outside it."""
_BISECTIONS = 14
_OFFSETS = np.array([o for o in np.ndindex(5, 5, 5) if 0 < sum((k - 2) ** 2 for k in o) <= 5]) - 2


def surface_steps(distance: Floats) -> Bytes:
    """Convert signed distances [voxel], negative inside, to stored surface distances."""
    return np.clip(np.rint(SURFACE_ZERO + SURFACE_STEPS * distance), INSIDE, OUTSIDE).astype(
        np.uint8
    )


def near_the_surface(
    volume: VoxelVolume,
) -> tuple[Bytes, Bytes, NDArray[np.uint16], Bytes]:
    """Return surface distance, layer, density and boundary distance of a volume, each of its shape.

    Layer and density continue beyond the surface, as far as its distance is known: a point between
    the last voxel centre in the bone and the first one outside lies in a layer too.
    """
    surface = (
        volume.surface_distance
        if volume.surface_distance is not None
        else surface_of_fractions(volume.fraction)
    )
    if volume.layer_distance is not None:
        return surface, volume.layer, volume.density_kg_m3, volume.layer_distance
    layer, density, known = carried_beyond(
        volume.fraction, surface, volume.layer, volume.density_kg_m3
    )
    return surface, layer, density, boundary_of_layers(layer, known)


def carried_beyond(
    fraction: Bytes, surface: Bytes, layer: Bytes, density: NDArray[np.uint16]
) -> tuple[Bytes, NDArray[np.uint16], Flags]:
    """Extend layer and density of the outermost voxels beyond the surface.

    Also return flags of the voxels where they are known.
    """
    layer = layer.copy()
    density = density.copy()
    known = fraction > 0
    for _ in range(2):
        wanted = (surface < OUTSIDE) & ~known
        for axis in range(3):
            for low, high in (_halves(axis), _halves(axis)[::-1]):
                taken = wanted[low] & known[high]
                layer[low][taken] = layer[high][taken]
                density[low][taken] = density[high][taken]
                known[low] |= taken
                wanted[low] &= ~taken
    return layer, density, known


def surface_of_fractions(fraction: Bytes) -> Bytes:
    """Compute the stored surface distance of voxels from their filled fractions.

    The result is uint8, shape (nx, ny, nz).

    Each voxel that the surface crosses or passes next to has a plane. The plane leaves the voxel's
    fraction behind it, and its direction is the gradient of the fractions. Voxels near those take
    the mean over their planes. There is no bone beyond the array. On a ball the mean lies below the
    true distance and the interpolation between centres lies above it. Each bias is a twelfth of the
    principal curvatures' sum; the interpolated surface keeps a quarter of it.
    """
    padded = np.pad(fraction, 3)
    result = np.where(padded > 127, INSIDE, OUTSIDE).astype(np.uint8)
    crossed = ((padded > 0) & (padded < 255)) | _beside(padded == 255, padded == 0)
    at = np.argwhere(crossed)
    normal = _outward(padded, at)
    share = padded[crossed] / 255.0
    total = np.abs(normal).sum(axis=1)
    distance = _plane_distance(share, normal)
    known = np.full(padded.shape, -1, dtype=np.int32)
    planes = len(at)
    known[crossed] = np.arange(planes, dtype=np.int32)
    near = np.argwhere(_grown(_grown(crossed)))
    summed, weights = np.zeros((2, len(near)))
    # A full or an empty voxel next to the surface bounds its distance and does not give it.
    trust = np.where((share > 0.0) & (share < 1.0), 1.0, np.where(total > 0.0, 1e-3, 0.0))
    for offset in np.vstack([np.zeros((1, 3), dtype=int), _OFFSETS]):
        there = tuple(np.clip(near + offset, 0, np.array(padded.shape) - 1).T)
        plane = known[there]
        held = np.flatnonzero(plane >= 0)
        index = plane[held]
        weight = trust[index] / (0.25 + float(offset @ offset)) ** 2
        summed[held] += weight * (distance[index] - normal[index] @ offset)
        weights[held] += weight
    found = weights > 0.0
    steps = surface_steps(summed[found] / weights[found])
    result[tuple(near[found].T)] = steps
    return np.ascontiguousarray(result[3:-3, 3:-3, 3:-3])


def _plane_distance(share: Floats, normal: Floats) -> Array:
    """Compute the signed distance of unit cubes' centres from a plane.

    The plane leaves a given share of the cube behind it.
    """
    half = 0.5 * np.abs(normal).sum(axis=1)
    low = -half
    high = half.copy()
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        more = cube_fraction(middle, normal) > share
        low = np.where(more, middle, low)
        high = np.where(more, high, middle)
    return np.asarray(0.5 * (low + high))


def _outward(fraction: Bytes, at: Ints) -> Array:
    """Return unit vectors down the gradient of the fractions in 3 x 3 x 3 voxels, shape (n, 3).

    The vector is z where the gradient is zero.
    """
    slope = np.zeros((len(at), 3))
    for offset in np.array(list(np.ndindex(3, 3, 3))) - 1:
        if offset.any():
            weight = 2.0 ** (2 - np.abs(offset).sum())
            slope -= weight * fraction[tuple((at + offset).T)].astype(np.float64)[:, None] * offset
    slope[~slope.any(axis=1), 2] = 1.0
    return slope / np.linalg.norm(slope, axis=1)[:, None]


def _beside(one: Flags, other: Flags) -> Flags:
    """Flag voxels of either kind that share a face with one of the other kind."""
    met = np.zeros(one.shape, dtype=bool)
    for axis in range(3):
        a, b = _halves(axis)
        pairs = (one[a] & other[b]) | (other[a] & one[b])
        met[a] |= pairs
        met[b] |= pairs
    return met


def _grown(flags: Flags) -> Flags:
    """Flag all voxels that touch flagged ones, too."""
    grown = flags.copy()
    for axis in range(3):
        a, b = _halves(axis)
        before = grown.copy()
        grown[a] |= before[b]
        grown[b] |= before[a]
    return grown


def _halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return slices of all but the last and all but the first along an axis."""
    low, high = ([slice(None)] * 3 for _ in range(2))
    low[axis] = slice(0, -1)
    high[axis] = slice(1, None)
    return tuple(low), tuple(high)
