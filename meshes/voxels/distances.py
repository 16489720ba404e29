"""Distances from voxel centres to the bone's surface and to layer boundaries, stored as bytes.

The distances are interpolated between voxel centres. The position error of the surface or boundary
is therefore of second order in the spacing. Without interpolation, the error would be as large as a
voxel.

Distances to the nearest boundary are computed from a function that returns the layer at any point,
or from the labels of the voxels. These distances are computed only for voxels at the corners of
cells with at least two different layers. A cell is the cube between eight neighbouring voxel
centres. The distances of other voxels are never used.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints, Singles
from meshes.voxels.label_shares import depth_of_share, spread_labels
from meshes.voxels.volume import VoxelVolume

_SMALLEST_COMPONENT = 1e-5  # see `cube_fraction`


def cube_fraction(distance: Floats, normal: Floats) -> Array:
    """Compute the volume of the part of a unit cube that lies behind a plane.

    The part is n·x <= -distance, where n is the plane's normal and the origin is the centre of the
    cube. Let m = |n| / Σ|n| and a = 1/2 - distance / Σ|n|. Here, a is the plane's distance from the
    cube's lowest corner, divided by the cube's extent. Both lengths are measured along n. The
    volume is Σ_S (-1)^|S| (a - Σ_{i∈S} m_i)₊³ / (6 m1 m2 m3), summed over the subsets S of the
    three axes. The formula is derived with the inclusion-exclusion principle over the cube's
    corners. It is equivalent to the formula of Scardovelli & Zaleski 2000, J. Comput. Phys.
    164:228. Components of m below 1e-5 are set to 1e-5, which changes the volume by less than 2e-5.

    Parameters
    ----------
    distance
        Signed distance of the cube's centre from the plane, shape (n,), in units of the cube's
        edge. It is positive in front of the plane.
    normal
        Outward unit normals of the planes, shape (n, 3).

    Returns
    -------
    Fractions in [0, 1], shape (n,).
    """
    m = np.abs(np.asarray(normal, dtype=np.float64)).T
    total = m.sum(axis=0)
    height = np.clip(0.5 - np.asarray(distance, dtype=np.float64) / total, 0.0, 1.0)
    m = np.maximum(m / total, _SMALLEST_COMPONENT)
    m /= m.sum(axis=0)
    lower_half = np.minimum(height, 1.0 - height)
    volume = np.zeros_like(height)
    for chosen in itertools.product((0, 1), repeat=3):
        rest = lower_half - sum(m[k] for k in range(3) if chosen[k])
        volume += (-1) ** sum(chosen) * np.maximum(rest, 0.0) ** 3
    volume /= 6.0 * m[0] * m[1] * m[2]
    return np.where(height > 0.5, 1.0 - volume, volume)


SURFACE_STEPS = 63
"""Number of stored steps per voxel of distance. Surface distances are limited to two voxels."""
SURFACE_ZERO = 128
INSIDE = 2
OUTSIDE = 254
"""Stored values on the surface (`SURFACE_ZERO`), and two or more voxels inside and outside."""
_BISECTIONS = 14
"""Number of bisection steps in the search for the distance of a plane.

The remaining interval of 1e-4 voxels is small compared with a stored step of 0.016 voxels.
"""
# neighbours up to (2, 1, 0) away
_OFFSETS = np.array([o for o in np.ndindex(5, 5, 5) if 0 < sum((k - 2) ** 2 for k in o) <= 5]) - 2


def surface_steps(distance: Floats) -> Bytes:
    """Convert signed distances [voxel], negative inside, to the format of stored distances."""
    return np.clip(np.rint(SURFACE_ZERO + SURFACE_STEPS * distance), INSIDE, OUTSIDE).astype(
        np.uint8
    )


def near_the_surface(
    volume: VoxelVolume,
) -> tuple[Bytes, Bytes, NDArray[np.uint16], Bytes]:
    """Return surface distance, layer, density and boundary distance of a volume.

    The arrays have the shape of the volume. The layer and the density are extended beyond the
    surface to all voxels whose surface distance is known. The extension is needed for points
    between the last voxel centre in the bone and the first voxel centre outside.
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
    """Extend the layer and the density of the outermost voxels to voxels outside the surface.

    Also return flags of the voxels whose layer and density are known after the extension.
    """
    layer = layer.copy()
    density = density.copy()
    known = fraction > 0
    for _ in range(2):
        wanted = (surface < OUTSIDE) & ~known
        for axis in range(3):
            views = [np.moveaxis(each, axis, 0) for each in (layer, density, known, wanted)]
            for low, high in ((slice(-1), slice(1, None)), (slice(1, None), slice(-1))):
                layers, densities, is_known, is_wanted = views
                taken = is_wanted[low] & is_known[high]
                layers[low][taken] = layers[high][taken]
                densities[low][taken] = densities[high][taken]
                is_known[low] |= taken
                is_wanted[low] &= ~taken
    return layer, density, known


def surface_of_fractions(fraction: Bytes) -> Bytes:
    """Convert the filled fractions of voxels to encoded surface distances.

    The result is uint8, shape (nx, ny, nz).

    For each voxel at or next to the surface, a plane is computed. The plane is normal to the
    gradient of the fractions. The plane is placed so that the fraction of the voxel behind it is
    equal to the filled fraction. The surface distance of a voxel is a weighted mean of the
    distances between its centre and the planes of nearby voxels. The space outside the array counts
    as empty. On a ball, the mean is smaller than the true distance, but interpolation between voxel
    centres increases the distance. Each of these two biases [voxel] is a twelfth of the sum of the
    principal curvatures [1/voxel]. After interpolation, the remaining bias is a quarter of one of
    these biases.
    """
    from scipy.ndimage import binary_dilation, maximum_filter

    # A margin of three voxels: two for the reach of planes, and one for the gradient.
    padded = np.pad(fraction, 3)
    result = np.where(padded > 127, INSIDE, OUTSIDE).astype(np.uint8)
    # A flat surface may lie exactly between full and empty voxels, without partly filled voxels.
    full = padded == 255
    empty = padded == 0
    crossed = (full & binary_dilation(empty)) | (empty & binary_dilation(full)) | ~(full | empty)
    at = np.argwhere(crossed)
    normal = _outward(padded, at)
    share = padded[crossed] / 255.0
    total = np.abs(normal).sum(axis=1)
    distance = _plane_distance(share, normal)
    known = np.full(padded.shape, -1, dtype=np.int32)
    planes = len(at)
    known[crossed] = np.arange(planes, dtype=np.int32)
    near = np.argwhere(maximum_filter(crossed, 5))
    summed, weights = np.zeros((2, len(near)))
    # A full or an empty voxel next to the surface only gives a bound for the distance.
    trust = np.where((share > 0.0) & (share < 1.0), 1.0, np.where(total > 0.0, 1e-3, 0.0))
    for offset in np.vstack([np.zeros((1, 3), dtype=int), _OFFSETS]):
        there = tuple(np.clip(near + offset, 0, np.array(padded.shape) - 1).T)
        plane = known[there]
        held = np.flatnonzero(plane >= 0)
        index = plane[held]
        # Near planes have the largest weights. With values of 0.1 to 0.5, the error on a ball is
        # 0.019 to 0.025 voxels (RMS).
        weight = trust[index] / (0.25 + float(offset @ offset)) ** 2
        summed[held] += weight * (distance[index] - normal[index] @ offset)
        weights[held] += weight
    found = weights > 0.0
    steps = surface_steps(summed[found] / weights[found])
    result[tuple(near[found].T)] = steps
    return np.ascontiguousarray(result[3:-3, 3:-3, 3:-3])


def _plane_distance(share: Floats, normal: Floats) -> Array:
    """Compute the signed distance of the centre of each unit cube from a plane.

    Each cube has its own plane. The plane is given by `normal` and by `share`, the part of the cube
    behind the plane.
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
    """Return unit vectors opposite to the gradient of the fractions, shape (n, 3).

    The gradient is computed from 3 x 3 x 3 voxels. If the gradient is zero, the vector points along
    z.
    """
    slope = np.zeros((len(at), 3))
    for offset in np.array(list(np.ndindex(3, 3, 3))) - 1:
        if offset.any():
            # Weights of a 3 x 3 x 3 Sobel filter: 2 for a face neighbour, 1 for an edge, 1/2 for a
            # corner.
            weight = 2.0 ** (2 - np.abs(offset).sum())
            slope -= weight * fraction[tuple((at + offset).T)].astype(np.float64)[:, None] * offset
    slope[~slope.any(axis=1), 2] = 1.0
    return slope / np.linalg.norm(slope, axis=1)[:, None]


BOUNDARY_STEPS = 127
"""Number of stored steps per voxel of distance. Boundary distances are limited to two voxels."""
FAR = 254
"""Stored distance of a voxel that is more than two voxels away from every boundary between layers.

The value is also used if no cell with the voxel as a corner contains a boundary.
"""
_UNKNOWN = 255
_PADDED = 2
"""Width [voxel] of the border that is added around arrays of layers.

The width is the largest component of `_OFFSETS`.
"""
_AT_ONCE = 1 << 18
"""Number of pairs (voxel, neighbour) that are summed at once. The pairs take a few MB."""
_STRIDE = 0.5
_HALVINGS = 5
"""Number of bisections in the search for a layer boundary, after steps of `_STRIDE` [voxel].

The middle of the remaining interval has an error of up to 0.008 voxels. This is one step of the
stored distance.
"""
_DEVIATION = 1.25
"""Standard deviation [voxel] with which layer masks are smoothed to compute distances.

With this value, the RMS error of the distance is 0.06 voxels on a plane, 0.08 voxels on a ball with
a radius of 8 voxels, and 0.11 voxels on a block. With 2 instead of 1.25, these errors are 0.04,
0.06 and 0.15 voxels, and a layer with a thickness of one voxel almost vanishes.
"""

LayerAt = Callable[[Singles], Bytes]
"""Function from points [voxel], shape (n, 3), to layer indices, shape (n,)."""


def layer_boundary(layer: Bytes, known: Flags, layer_at: LayerAt) -> Bytes:
    """Compute the stored distance from each voxel centre to the nearest boundary between layers.

    The result has the shape (nx, ny, nz).

    For each voxel, the direction to the boundary is computed from the surrounding voxels that
    belong to a different layer. Along this direction, the function searches for the boundary in
    steps of half a voxel and then refines it by bisection.

    Parameters
    ----------
    layer
        Layer of each voxel, shape (nx, ny, nz).
    known
        Flags of the voxels whose layer is known, shape (nx, ny, nz).
    layer_at
        Function that returns the layer between voxel centres. The centre of voxel (i, j, k) is (i +
        0.5, j + 0.5, k + 0.5).
    """
    codes = _codes(layer, known)
    chosen = _in_mixed_cells(codes)
    toward = _toward_others(codes, chosen)
    length = np.linalg.norm(toward, axis=1)
    found = length > 0.0
    chosen = chosen[found]
    direction = toward[found] / length[found, None]
    distance = np.empty(len(chosen), dtype=np.float32)
    # Parts of 65,536 points limit the memory of the layer function.
    for start in range(0, len(chosen), 1 << 16):
        part = slice(start, start + (1 << 16))
        at = np.column_stack(np.unravel_index(chosen[part], codes.shape)) - _PADDED
        distance[part] = _distance(at, codes.ravel()[chosen[part]], direction[part], layer_at)
    return _stored(codes, chosen, distance)


def boundary_of_layers(layer: Bytes, known: Flags) -> Bytes:
    """Convert the layer of each voxel to the stored distance to the nearest layer boundary.

    The mask of each layer is smoothed. The smoothed value (share) at a voxel is converted to a
    distance. At this distance from a plane boundary, the share has the same value. The distances
    are corrected such that each voxel's centre stays in the voxel's layer. Boundaries are therefore
    shifted by at most half a voxel. If most neighbours of a voxel are in other layers, the voxel's
    distance is increased to a value of up to half a voxel. A layer with a thickness of one voxel
    therefore does not vanish.
    """
    from scipy.ndimage import uniform_filter

    codes = _codes(layer, known)
    chosen = _in_mixed_cells(codes)
    distance = np.zeros(codes.shape, dtype=np.float32)
    if len(chosen) == 0:
        return _stored(codes, chosen, np.empty(0))
    within = (codes != _UNKNOWN).astype(np.float32)
    spread = spread_labels(within, _DEVIATION)
    near = uniform_filter(within, 3)
    for number in np.unique(codes.ravel()[chosen]):
        own = codes == number
        mask = own.astype(np.float32)
        share = spread_labels(mask, _DEVIATION)[own] / spread[own]
        # In a layer of one voxel, a third of the 27 neighbours have the same layer, and the
        # smallest distance is 0.5. At a flat boundary, two thirds have the same layer, and the
        # smallest distance is one stored step.
        least = 1.4 - 2.7 * uniform_filter(mask, 3)[own] / near[own]
        least = np.clip(least, 1.0 / BOUNDARY_STEPS, 0.5)
        distance[own] = np.maximum(_DEVIATION * depth_of_share(share), least)
    return _stored(codes, chosen, distance.ravel()[chosen])


def _codes(layer: Bytes, known: Flags) -> Bytes:
    """Return the array of layers with a border added around it.

    The value is 255 in the border and in voxels whose layer is not known.
    """
    return np.pad(np.where(known, layer, np.uint8(_UNKNOWN)), _PADDED, constant_values=_UNKNOWN)


def _stored(codes: Bytes, chosen: NDArray[np.intp], distance: Floats) -> Bytes:
    """Convert distances [voxel] of the chosen voxels to stored bytes, and remove the border.

    Voxels that are not chosen get the value `FAR`.
    """
    result = np.full(codes.shape, FAR, dtype=np.uint8)
    result.ravel()[chosen] = np.rint(np.minimum(BOUNDARY_STEPS * distance, FAR))
    return np.ascontiguousarray(result[(slice(_PADDED, -_PADDED),) * 3])


def _in_mixed_cells(codes: Bytes) -> NDArray[np.intp]:
    """Return flat indices of the known voxels in cells with at least two layers.

    A cell consists of 2 x 2 x 2 voxels. A cell has at least two layers if two face neighbours in
    the cell have different known layers.
    """
    flat = codes.ravel()
    steps = _strides(codes)
    mixed = np.zeros(flat.shape, dtype=bool)
    for axis, step in enumerate(steps):
        differ = np.flatnonzero(flat[:-step] != flat[step:])
        differ = differ[(flat[differ] != _UNKNOWN) & (flat[differ + step] != _UNKNOWN)]
        one, other = np.delete(steps, axis)
        for along in (0, step):
            for a in (-one, 0, one):
                for b in (-other, 0, other):
                    mixed[differ + (along + a + b)] = True
    chosen = np.flatnonzero(mixed)
    return chosen[flat[chosen] != _UNKNOWN]


def _toward_others(codes: Bytes, at: NDArray[np.intp]) -> Singles:
    """Compute the sum, shape (n, 3), of weighted offsets to neighbours in other known layers.

    The weights are integer multiples of 1/60, so the sums are exact in any order.
    """
    flat = codes.ravel()
    shifts = (_OFFSETS @ _strides(codes))[:, None]
    weights = (60 // (_OFFSETS**2).sum(axis=1) * _OFFSETS.T).astype(np.float32)
    found = np.empty((3, len(at)), dtype=np.float32)
    count = _AT_ONCE // len(_OFFSETS)
    for start in range(0, len(at), count):
        part = slice(start, start + count)
        there = flat.take(at[part] + shifts)
        other = (there != flat[at[part]]) & (there != _UNKNOWN)
        found[:, part] = weights @ other.astype(np.float32)
    return found.T


def _strides(array: Bytes) -> Ints:
    """Return the change of the flat index for one step along each axis."""
    return np.array([array.shape[1] * array.shape[2], array.shape[2], 1])


def _distance(at: Ints, this: Bytes, direction: Singles, layer_at: LayerAt) -> Singles:
    """Compute the distance [voxel] from voxel centres to a change of layer along given directions.

    The distances, shape (n,), are limited to 2.
    """
    centre = at.astype(np.float32) + np.float32(0.5)
    low, high = np.zeros((2, len(at)), dtype=np.float32)
    open_ = np.arange(len(at))
    for reach in np.arange(_STRIDE, 2.0 + _STRIDE, _STRIDE, dtype=np.float32):
        changed = layer_at(centre[open_] + reach * direction[open_]) != this[open_]
        high[open_[changed]] = reach
        low[open_[changed]] = reach - _STRIDE
        open_ = open_[~changed]
    low[open_] = high[open_] = 2.0
    found = np.flatnonzero(high > low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low[found] + high[found])
        changed = layer_at(centre[found] + middle[:, None] * direction[found]) != this[found]
        high[found[changed]] = middle[changed]
        low[found[~changed]] = middle[~changed]
    return 0.5 * (low + high)
