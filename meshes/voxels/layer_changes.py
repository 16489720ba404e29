"""Distances of voxels to the nearest change of layer, in bytes.

They come from the layer at any point, or from labels alone.

Only voxels in a cell of eight centres with two different layers have a distance. The distance of
other voxels is never used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints, Singles

__all__ = ["FAR", "LayerAt", "boundary_of_layers", "layer_boundary"]

BOUNDARY_STEPS = 127
"""Stored steps per voxel; stored distances reach two voxels."""
FAR = 254
"""Stored distance of voxels that are far from any change of layer.

No layer changes within two voxels, or in any cell that the voxel is a corner of.
"""
_UNKNOWN = 255
_PADDED = 6
_AT_ONCE = 1 << 18
_STRIDE = 0.5
_HALVINGS = 5
"""Steps [voxel] that bracket a change along a direction, and number of bisections."""
_WIDE = 6.0
_NARROW = 3.0
"""Radii of the balls [voxel] whose shares give the distance."""
_DISAGREES = 0.25
_REACH = 2
"""Deviation [voxel] of a label above which the narrow ball counts, and reach of that [voxel]."""

LayerAt = Callable[[Singles], Bytes]
"""Points [voxel], shape (n, 3), to their layers, shape (n,)."""


def layer_boundary(layer: Bytes, known: Flags, layer_at: LayerAt) -> Bytes:
    """Compute the stored distance of voxel centres to the nearest change of layer.

    The result has the shape (nx, ny, nz).

    The voxels of other layers around a voxel give the direction; along it the change is bracketed
    in half voxels, then halved.

    Parameters
    ----------
    layer
        Layer of each voxel, shape (nx, ny, nz).
    known
        Voxels whose layer has a meaning, shape (nx, ny, nz).
    layer_at
        Layer between the voxel centres; voxel (i, j, k) has its centre at (i + 0.5, j + 0.5, k +
        0.5).
    """
    codes = _codes(layer, known)
    chosen = _in_mixed_cells(codes)
    offsets = _offsets(np.sqrt(5.0) + 1e-6)
    # In sixtieths, whole numbers: their sums are exact in any order.
    toward = _sums(
        codes, chosen, offsets, 60 // np.maximum((offsets**2).sum(axis=1), 1) * offsets.T
    )[1].T
    length = np.linalg.norm(toward, axis=1)
    found = length > 0.0
    chosen = chosen[found]
    direction = toward[found] / length[found, None]
    distance = np.empty(len(chosen), dtype=np.float32)
    for start in range(0, len(chosen), 1 << 16):
        part = slice(start, start + (1 << 16))
        at = np.column_stack(np.unravel_index(chosen[part], codes.shape)) - _PADDED
        distance[part] = _distance(at, codes.ravel()[chosen[part]], direction[part], layer_at)
    return _stored(codes, chosen, distance)


def boundary_of_layers(layer: Bytes, known: Flags) -> Bytes:
    """Compute the stored distance to the nearest change of layer from labels alone.

    The distance follows from the share of a voxel's layer in the ball of six voxels around it, see
    `_ball`. A ball of three voxels is used where labels disagree with that distance by a quarter
    voxel, at corners and thin layers. Each voxel's centre stays in its layer, so that no boundary
    moves by more than half a voxel. A voxel with most neighbours in other layers keeps up to half a
    voxel around its centre, so that a layer of one voxel does not vanish.
    """
    codes = _codes(layer, known)
    chosen = _in_mixed_cells(codes)
    distance = _distance_of_share(codes, chosen, _WIDE)
    disagreeing = np.zeros(codes.size, dtype=bool)
    around = np.array(list(np.ndindex((2 * _REACH + 1,) * 3))) - _REACH
    for shift in around @ _strides(codes):
        disagreeing[chosen[distance < -_DISAGREES] + shift] = True
    narrow = np.flatnonzero(disagreeing[chosen])
    distance[narrow] = _distance_of_share(codes, chosen[narrow], _NARROW)
    neighbours = _offsets(np.sqrt(3.0) + 1e-6)
    same, other = _sums(codes, chosen, neighbours, np.ones((1, len(neighbours))))
    least = np.clip(1.4 - 2.7 * same[0] / (same[0] + other[0]), 1.0 / BOUNDARY_STEPS, 0.5)
    return _stored(codes, chosen, np.maximum(distance, least))


def _codes(layer: Bytes, known: Flags) -> Bytes:
    """Return layers with a border around them.

    They are 255 in the border and where they are not known.
    """
    return np.pad(np.where(known, layer, np.uint8(_UNKNOWN)), _PADDED, constant_values=_UNKNOWN)


def _stored(codes: Bytes, chosen: NDArray[np.intp], distance: Floats) -> Bytes:
    """Return distances [voxel] of the chosen voxels as bytes, without the border.

    Other voxels are `FAR`.
    """
    result = np.full(codes.shape, FAR, dtype=np.uint8)
    result.ravel()[chosen] = np.rint(np.minimum(BOUNDARY_STEPS * distance, FAR))
    return np.ascontiguousarray(result[(slice(_PADDED, -_PADDED),) * 3])


def _in_mixed_cells(codes: Bytes) -> NDArray[np.intp]:
    """Return flat indices of the known voxels in cells with two layers.

    A cell has 2 x 2 x 2 voxels. Two neighbours in it differ in layer.
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


def _sums(
    codes: Bytes, at: NDArray[np.intp], offsets: Ints, weights: NDArray[np.generic]
) -> tuple[Singles, Singles]:
    """Compute weighted sums over the known voxels around each voxel, shapes (rows, n).

    One sum is over the voxel's own layer, the other over other layers.

    ``weights`` has the shape (rows, offsets); whole numbers up to 2**24 in all are summed exactly,
    on any machine.
    """
    flat = codes.ravel()
    shifts = (offsets @ _strides(codes))[:, None]
    weights = weights.astype(np.float32)
    inside, outside = np.empty((2, len(weights), len(at)), dtype=np.float32)
    count = _AT_ONCE // len(offsets)
    for start in range(0, len(at), count):
        part = slice(start, start + count)
        there = flat.take(at[part] + shifts)
        same = there == flat[at[part]]
        inside[:, part] = weights @ same.astype(np.float32)
        outside[:, part] = weights @ (~same & (there != _UNKNOWN)).astype(np.float32)
    return inside, outside


def _distance_of_share(codes: Bytes, at: NDArray[np.intp], radius: float) -> Array:
    """Compute the distance [voxel] to the plane that leaves a voxel's own share of a ball.

    The ball is around the voxel. The distance is negative beyond the plane.
    """
    offsets, weights, share, distance = _ball(radius)
    same, other = (sums[0].astype(np.float64) for sums in _sums(codes, at, offsets, weights))
    return np.asarray(np.interp(same / (same + other), share, distance))


@cache
def _ball(radius: float) -> tuple[Ints, Array, Array, Array]:
    """Compute offsets and weights in a ball, and the share behind a plane.

    The share is a function of the plane's distance [voxel] from the centre.

    The weight (1 - r²)² (1 - 5/2 r²), r relative to the radius, has no second moment in a plane
    through the centre. The share behind a surface through the centre therefore does not change with
    the curvature, to first order. The share grows with the distance t up to the weight's turning
    point, t² = 1/5. The weight summed over the plane at t is, up to a factor, (1 - t²)³ (5/8 (1 -
    t²) - 1/2).
    """
    offsets = _offsets(radius)
    r2 = (offsets**2).sum(axis=1) / radius**2
    weights = (1.0 - r2) ** 2 * (1.0 - 2.5 * r2)
    weights = np.rint(2.0**22 / np.abs(weights).sum() * weights)
    t = np.linspace(-1.0, 1.0, 4001)
    slices = (1.0 - t**2) ** 3 * (0.625 * (1.0 - t**2) - 0.5)
    share = np.cumsum(slices) - 0.5 * slices
    share /= slices.sum()
    grows = t**2 <= 0.2
    return offsets, weights[None], share[grows], radius * t[grows]


def _offsets(radius: float) -> Ints:
    """Return whole offsets shorter than a radius [voxel], shape (n, 3)."""
    reach = int(radius)
    offsets = np.array(list(np.ndindex((2 * reach + 1,) * 3))) - reach
    return offsets[(offsets**2).sum(axis=1) < radius**2]


def _strides(array: Bytes) -> Ints:
    """Return steps along each axis in the flat array."""
    return np.array([array.shape[1] * array.shape[2], array.shape[2], 1])


def _distance(at: Ints, this: Bytes, direction: Singles, layer_at: LayerAt) -> Singles:
    """Compute the distance [voxel] from voxel centres along a direction to the change of layer.

    It is at most 2, shape (n,).
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
