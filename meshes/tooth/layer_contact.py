"""Overlaps, gaps and enclosed voids between the layers of a tooth, measured on a lattice of points.

A gap is a space between two layers that should touch, with a width of at most 0.3 mm along x, y or
z. At its deepest point, a gap is more than 0.45 mm below the outer surface. Wider spaces, and
spaces between layers that need not touch, are part of the anatomy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Ints, Singles, Triangles
from meshes.base.errors import InputError
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.voxels.mesh_sampling import column_crossings, inside_scattered

PITCH_M = 0.1e-3
"""Distance between the lattice points [m]."""

_CUBE_MM3 = (1e3 * PITCH_M) ** 3
_WIDEST_GAP_M = 0.3e-3  # see above
_TOUCHING = [
    {"enamel", "dentin"},
    {"dentin", "pulp"},
    {"caries", "enamel"},
    {"caries", "dentin"},
    {"dentin", "ligament"},
    {"ligament", "bone"},
]
_TOUCH_M = 0.5e-3
"""Largest distance between two layers that count as touching [m]."""
_POINTS_TESTED = 4000
"""Number of surface points of a layer at which the distance to other layers is measured.

On the surface of a tooth, the points are 0.3 mm apart.
"""
_NEAR_M = 0.2e-3
_LEAST_WITHIN = 0.6
"""Smallest valid share of the pulp's surface that lies in the dentin or near its surface.

Near means at a distance of less than ``_NEAR_M``.
"""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Values on a lattice of points.

    `pitch` is the spacing of the points [m], and `origin` is the first point [m].
    """

    origin: Array
    pitch: float
    values: NDArray[np.number]

    def __call__(self, points: Floats, *, beyond: float) -> Singles:
        """Interpolate the values linearly at points [m], shape (n, 3).

        The result is `beyond` outside the lattice.
        """
        from scipy.ndimage import map_coordinates

        index = ((points - self.origin) / self.pitch).T
        return map_coordinates(
            self.values, index, output=np.float32, order=1, mode="constant", cval=beyond
        )

    def nearest(self, points: Floats) -> NDArray[np.number]:
        """Return the value at the nearest lattice point, or 0 outside the lattice."""
        index = np.rint((points - self.origin) / self.pitch).astype(np.int64)
        held = ((index >= 0) & (index < self.values.shape)).all(axis=1)
        found = np.zeros(len(points), dtype=self.values.dtype)
        found[held] = self.values[tuple(index[held].T)]
        return found


def inside_lattice(vertices: Array, faces: Ints, axes: Sequence[Array]) -> Flags:
    """Return flags, shape (nx, ny, nz), of the lattice points that lie in a closed surface.

    Parameters
    ----------
    axes
        Coordinates of the lattice points along x, y and z [m], each evenly spaced and ascending.
    """
    x, y, z = axes
    crossings = column_crossings(vertices, faces, x, y)
    above = np.searchsorted(z, crossings.height)
    change = np.bincount(
        crossings.line * (len(z) + 1) + above,
        weights=crossings.entering,
        minlength=len(x) * len(y) * (len(z) + 1),
    )
    # Winding numbers are integers, but stored in floating point.
    return np.cumsum(change.reshape(len(x), len(y), len(z) + 1), axis=2)[:, :, :-1] > 0.5


def measure_contact(solids: Mapping[str, Triangles]) -> tuple[Lattice, dict[str, str]]:
    """Measure overlaps, gaps and voids of layers on a lattice with the spacing `PITCH_M`.

    Parameters
    ----------
    solids
        Dictionary from layer name to vertices [m] and triangles, in order of priority. The overlap
        of two layers and the gap between two layers are assigned to the layer that comes first.

    Returns
    -------
    Lattice, and notes on overlaps, gaps and voids. The value of a lattice point in a gap is 1 plus
    the index of the layer to which the gap is assigned. Lattice points outside gaps have the value
    0.
    """
    from scipy.ndimage import binary_fill_holes

    # Two empty planes on each side. The half step avoids points on flat faces at multiples of the
    # spacing.
    low = np.min([vertices.min(axis=0) for vertices, _ in solids.values()], axis=0) - 2.5 * PITCH_M
    high = np.max([vertices.max(axis=0) for vertices, _ in solids.values()], axis=0) + 2.5 * PITCH_M
    axes = [
        a + PITCH_M * np.arange(int(np.ceil((b - a) / PITCH_M)))
        for a, b in zip(low, high, strict=True)
    ]
    inside = {name: inside_lattice(*solid, axes) for name, solid in solids.items()}
    shared = {
        (a, b): int(np.count_nonzero(inside[a] & inside[b])) for a, b in combinations(inside, 2)
    }
    label = np.zeros([len(axis) for axis in axes], dtype=np.uint8)
    for name in reversed(inside):
        label[inside[name]] = TOOTH_LAYERS.index(name) + 1
    gap_layer, gaps = _gaps(label, list(inside))
    void = binary_fill_holes(label > 0) & (label == 0) & (gap_layer == 0)
    notes = {"overlaps": _listed(shared), "gaps": _listed(gaps)}
    if void.any():
        notes["voids"] = (
            f"{_CUBE_MM3 * np.count_nonzero(void):.3g} mm3 are enclosed by the layers but belong "
            "to no layer, and are left empty"
        )
    return Lattice(low, PITCH_M, gap_layer), notes


def _listed(counts: Mapping[tuple[str, str], int]) -> str:
    """Format the volume of each pair of layers. `counts` contains numbers of lattice points."""
    volumes = [
        f"{one} and {other} {_CUBE_MM3 * count:.3g} mm3"
        for (one, other), count in counts.items()
        if count
    ]
    return ", ".join(volumes) or "none"


def _gaps(label: Bytes, names: list[str]) -> tuple[Bytes, dict[tuple[str, str], int]]:
    """Assign each lattice point in a gap to a layer.

    Return an array with 1 plus the index of this layer, and 0 outside gaps. Also return the number
    of gap points for each pair of layers.
    """
    pairs = [pair for pair in combinations(names, 2) if set(pair) in _TOUCHING]
    between = np.zeros_like(label)
    for axis in range(3):
        before, after, width = _neighbours(label, axis)
        spanned = (label == 0) & (between == 0) & (width * PITCH_M <= _WIDEST_GAP_M)
        for number, (one, other) in enumerate(pairs, start=1):
            first = TOOTH_LAYERS.index(one) + 1
            last = TOOTH_LAYERS.index(other) + 1
            forward = (before == first) & (after == last)
            backward = (before == last) & (after == first)
            between[spanned & (forward | backward)] = number
    if between.any():
        _drop_creases(between, label)
    found = np.bincount(between.ravel(), minlength=len(pairs) + 1)
    taker = np.array([0, *(TOOTH_LAYERS.index(one) + 1 for one, _ in pairs)], dtype=np.uint8)
    return taker[between], dict(zip(pairs, found[1:].tolist(), strict=True))


def _drop_creases(between: Bytes, label: Bytes) -> None:
    """Remove shallow spaces between layers from the array `between`, in place.

    A space is shallow if its depth is at most 1.5 times the largest gap width. Such a space is the
    crease between two layers at the outer surface, and not a gap.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.ndimage import label as connected

    depth = distance_transform_edt((label > 0) | (between > 0)) * PITCH_M
    pieces, count = connected(between > 0, np.ones((3, 3, 3)))
    deep = np.zeros(count + 1, dtype=bool)
    # A crease is open to the outside, so the depth of its points is at most the width of a gap. The
    # factor of 1.5 is a margin.
    deep[pieces[(between > 0) & (depth > 1.5 * _WIDEST_GAP_M)]] = True
    between[~deep[pieces]] = 0


def _neighbours(label: Bytes, axis: int) -> tuple[Bytes, Bytes, NDArray[np.int16]]:
    """Return the labels of the nearest filled points before and after each point along an axis.

    If there is no filled point on a side, the label is 0. Also return the number of points between
    the two filled points.
    """
    count = label.shape[axis]
    place = np.arange(count, dtype=np.int16).reshape([-1 if k == axis else 1 for k in range(3)])
    first = np.maximum.accumulate(np.where(label > 0, place, np.int16(-1)), axis=axis)
    backward = np.flip(np.where(label > 0, place, np.int16(count)), axis)
    last = np.flip(np.minimum.accumulate(backward, axis=axis), axis)
    # An empty plane at each end represents a missing filled point.
    ends = [(1, 1) if k == axis else (0, 0) for k in range(3)]
    padded = np.pad(label, ends)
    before = np.take_along_axis(padded, first.astype(np.intp) + 1, axis)
    after = np.take_along_axis(padded, last.astype(np.intp) + 1, axis)
    return before, after, last - first - np.int16(1)


def require_touching(points_m: Mapping[str, Array], solids: Mapping[str, Triangles]) -> None:
    """Raise an error for layers that do not touch another layer.

    Two layers touch if one layer lies in the other, or if the distance between them is at most 0.5
    mm.

    Parameters
    ----------
    points_m, solids
        Dictionaries from layer name to points [m], shape (n, 3), on the layer's surface, and from
        layer name to this surface (vertices [m] and triangles).
    """
    from scipy.spatial import cKDTree

    trees = {name: cKDTree(points) for name, points in points_m.items()}
    for name, points in points_m.items():
        tested = points[:: max(len(points) // _POINTS_TESTED, 1)]
        # One point inside another layer is sufficient, so a hundred points are tested.
        few = tested[:: max(len(tested) // 100, 1)]
        others = [other for other in trees if other != name]
        apart = {other: float(trees[other].query(tested)[0].min()) for other in others}
        nearest = min(apart, key=lambda other: apart[other])
        if apart[nearest] > _TOUCH_M and not any(
            inside_scattered(*solids[other], few).any() for other in others
        ):
            raise InputError(
                f"{name} surface",
                "touch another surface",
                f"a distance of {1e3 * apart[nearest]:.3g} mm from the nearest one, {nearest}",
                "export all surfaces in the same frame and unit",
            )


def require_pulp_within(pulp_m: Array, dentin: Triangles, dentin_samples_m: Array) -> None:
    """Raise an error if a pulp is not in the dentin.

    At least 60 % of the points of the pulp's surface must lie in the dentin or within 0.2 mm of its
    surface.

    Parameters
    ----------
    pulp_m, dentin_samples_m
        Points [m], shape (n, 3), on the surfaces of pulp and dentin.
    dentin
        Vertices [m] and triangles of the dentin.
    """
    from scipy.spatial import cKDTree

    # With 2000 points, the standard error of a share of 0.6 is 0.01.
    tested = pulp_m[:: max(len(pulp_m) // 2000, 1)]
    far = tested[cKDTree(dentin_samples_m).query(tested)[0] >= _NEAR_M]
    within = 1.0 - float(np.count_nonzero(~inside_scattered(*dentin, far))) / len(tested)
    if within < _LEAST_WITHIN:
        raise InputError(
            "pulp",
            "lie within the dentin",
            f"{100.0 * within:.0f} % of its surface in the dentin",
            "check which layer is which, and the frame of the pulp surface",
        )
