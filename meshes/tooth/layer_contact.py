"""How the layers of a tooth fit together: overlaps, gaps and enclosed voids, counted on a lattice of points.

A gap is a place in no layer that a line along x, y or z crosses between two layers that should touch, over at most
0.3 mm, and that reaches deeper than it is wide. Wider spaces, and those between layers that need not touch, are taken
as anatomy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.voxels.column_crossings import column_crossings, inside_scattered

__all__ = ["PITCH_M", "LayerContact", "inside_lattice", "inside_surface", "measure_contact"]

PITCH_M = 0.1e-3
"""Distance between the lattice points [m]."""

_WIDEST_GAP_M = 0.3e-3
_TOUCHING = ("enamel dentin", "dentin pulp", "caries enamel", "caries dentin", "dentin ligament", "ligament bone")
_LINES_A_POINT = 2


@dataclass(frozen=True, eq=False)
class LayerContact:
    """Overlaps and gaps.

    Attributes
    ----------
    overlap_mm3, gap_mm3
        Volume by pair of layer names, the pairs that have one.
    void_mm3
        Volume enclosed by the layers and in none of them, gaps left out.
    gap_layer
        Layer index + 1 of the layer that takes the gap at each lattice point, 0 elsewhere, uint8, shape (nx, ny, nz).
    """

    overlap_mm3: Mapping[tuple[str, str], float]
    gap_mm3: Mapping[tuple[str, str], float]
    void_mm3: float
    gap_layer: Bytes


def inside_surface(vertices: Array, faces: Ints, points: Floats) -> Flags:
    """Whether points [m], shape (n, 3), lie within a closed surface, by the vertical line through each.

    Points of a grid share their lines, which is what makes this quick.
    """
    x, i = np.unique(points[:, 0], return_inverse=True)
    y, j = np.unique(points[:, 1], return_inverse=True)
    if len(x) * len(y) > _LINES_A_POINT * len(points):
        return inside_scattered(vertices, faces, points)
    crossings = column_crossings(vertices, faces, x.astype(np.float64), y.astype(np.float64))
    if len(crossings.line) == 0:
        return np.zeros(len(points), dtype=bool)
    low = float(crossings.height.min())
    span = max(float(crossings.height.max()) - low, 1e-9)
    below = np.clip((points[:, 2].astype(np.float64) - low) / span, -0.4, 1.4)
    crossed = np.searchsorted(
        crossings.line + 0.25 + 0.5 * (crossings.height - low) / span, i * len(y) + j + 0.25 + 0.5 * below
    )
    return np.concatenate([[0], np.cumsum(crossings.entering)])[crossed] > 0


def inside_lattice(vertices: Array, faces: Ints, axes: Sequence[Array]) -> Flags:
    """Whether the points of a lattice lie within a closed surface, shape (nx, ny, nz).

    Parameters
    ----------
    axes
        Coordinates of the lattice along x, y and z [m], evenly spaced, ascending.
    """
    x, y, z = axes
    crossings = column_crossings(vertices, faces, x, y)
    above = np.searchsorted(z, crossings.height)
    change = np.bincount(
        crossings.line * (len(z) + 1) + above, weights=crossings.entering, minlength=len(x) * len(y) * (len(z) + 1)
    )
    return np.cumsum(change.reshape(len(x), len(y), len(z) + 1), axis=2)[:, :, :-1] > 0.5


def measure_contact(inside: Mapping[str, Flags], priority: Sequence[str]) -> LayerContact:
    """Overlaps and gaps of layers given as flags on a lattice of pitch `PITCH_M`.

    Parameters
    ----------
    inside
        Whether each lattice point lies within the layer, by layer name, all of shape (nx, ny, nz).
    priority
        Layer names; of two layers, the one named first takes what both hold and the gap between them.
    """
    from scipy.ndimage import binary_fill_holes

    cube_mm3 = (1e3 * PITCH_M) ** 3
    names = [name for name in priority if name in inside]
    overlaps = {}
    for k, one in enumerate(names):
        for other in names[k + 1 :]:
            count = int(np.count_nonzero(inside[one] & inside[other]))
            if count:
                overlaps[one, other] = count * cube_mm3
    label = np.zeros(next(iter(inside.values())).shape, dtype=np.uint8)
    for name in reversed(names):
        label[inside[name]] = TOOTH_LAYERS.index(name) + 1
    gap_layer, gaps = _gaps(label, names)
    enclosed = binary_fill_holes(label > 0) & (label == 0) & (gap_layer == 0)
    return LayerContact(
        overlaps,
        {pair: count * cube_mm3 for pair, count in gaps.items()},
        float(np.count_nonzero(enclosed)) * cube_mm3,
        gap_layer,
    )


def _gaps(label: Bytes, names: list[str]) -> tuple[Bytes, dict[tuple[str, str], int]]:
    """Layer index + 1 that takes each lattice point in a gap, and the number of points by pair of layers."""
    pairs = [(one, other) for k, one in enumerate(names) for other in names[k + 1 :] if _touch(one, other)]
    between = np.zeros_like(label)
    for axis in range(3):
        before, after, width = _neighbours(label, axis)
        spanned = (label == 0) & (between == 0) & (width * PITCH_M <= _WIDEST_GAP_M)
        for number, (one, other) in enumerate(pairs, start=1):
            a, b = TOOTH_LAYERS.index(one) + 1, TOOTH_LAYERS.index(other) + 1
            between[spanned & (((before == a) & (after == b)) | ((before == b) & (after == a)))] = number
    if between.any():
        _drop_creases(between, label)
    found = np.bincount(between.ravel(), minlength=len(pairs) + 1)
    taker = np.array([0, *(TOOTH_LAYERS.index(one) + 1 for one, _ in pairs)], dtype=np.uint8)
    return taker[between], {pair: int(n) for pair, n in zip(pairs, found[1:], strict=True) if n}


def _touch(one: str, other: str) -> bool:
    return f"{one} {other}" in _TOUCHING or f"{other} {one}" in _TOUCHING


def _drop_creases(between: Bytes, label: Bytes) -> None:
    """Clear, in place, what is nowhere deeper than a gap is wide: the crease in which two layers meet from outside."""
    from scipy.ndimage import distance_transform_edt
    from scipy.ndimage import label as connected

    depth = distance_transform_edt((label > 0) | (between > 0)) * PITCH_M
    pieces, count = connected(between > 0, np.ones((3, 3, 3)))
    deep = np.zeros(count + 1, dtype=bool)
    deep[pieces[(between > 0) & (depth > 1.5 * _WIDEST_GAP_M)]] = True
    between[~deep[pieces]] = 0


def _neighbours(label: Bytes, axis: int) -> tuple[Bytes, Bytes, NDArray[np.int16]]:
    """Labels of the nearest filled point before and after each one along an axis (0: none), and points between them."""
    count = label.shape[axis]
    place = np.arange(count, dtype=np.int16).reshape([-1 if k == axis else 1 for k in range(3)])
    first = np.maximum.accumulate(np.where(label > 0, place, np.int16(-1)), axis=axis)
    last = np.flip(np.minimum.accumulate(np.flip(np.where(label > 0, place, np.int16(count)), axis), axis=axis), axis)
    before = np.where(first < 0, 0, np.take_along_axis(label, np.maximum(first, 0).astype(np.intp), axis))
    after = np.where(last == count, 0, np.take_along_axis(label, np.minimum(last, count - 1).astype(np.intp), axis))
    return before.astype(np.uint8), after.astype(np.uint8), last - first - np.int16(1)
