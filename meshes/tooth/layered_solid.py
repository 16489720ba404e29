"""A solid of layers, each a closed surface: fraction, layer and density of voxels, gaps filled, a socket added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Bytes, Floats, Singles
from meshes.surfaces.repair import Triangles, merge_vertices
from meshes.tooth.layer_contact import inside_surface
from meshes.tooth.layers import BONE, LAYER_DENSITY_KG_M3, TOOTH_LAYERS
from meshes.voxels.grid import Grid
from meshes.voxels.mesh_sampling import TriangleSampler, triangle_distance

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["Lattice", "LayeredSolid", "joined", "socket_lattice"]

_SOCKET_PITCH_M = 0.2e-3
_MERGE_TOLERANCE_M = 1e-8
_DENSITY = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Lattice:
    """Values at points of even pitch [m], the first at `origin`."""

    origin: Array
    pitch: float
    values: NDArray[np.number]

    def __call__(self, points: Floats, *, beyond: float) -> Singles:
        """Interpolate linearly to points [m], shape (n, 3); `beyond` outside the lattice."""
        from scipy.ndimage import map_coordinates

        index = ((points - self.origin) / self.pitch).T
        return map_coordinates(self.values, index, output=np.float32, order=1, mode="constant", cval=beyond)

    def nearest(self, points: Floats) -> NDArray[np.number]:
        """Value at the nearest lattice point; 0 outside the lattice."""
        index = np.rint((points - self.origin) / self.pitch).astype(np.int64)
        held = ((index >= 0) & (index < self.values.shape)).all(axis=1)
        found = np.zeros(len(points), dtype=self.values.dtype)
        found[held] = self.values[tuple(index[held].T)]
        return found


@dataclass(frozen=True, eq=False)
class LayeredSolid:
    """Surfaces of the layers in the site frame, and what fills the space between and around them.

    Attributes
    ----------
    solids
        Vertices [m] and triangles by layer index, the layer with the highest priority first.
    union
        Surface of all of them; where they overlap it crosses itself.
    samples, sample_layer
        Points of all surfaces, and the layer index of each.
    gap
        Layer index + 1 that takes a gap, 0 elsewhere.
    socket
        Distance from the bone socket [m], negative inside.
    """

    solids: Mapping[int, Triangles]
    union: Triangles
    samples: cKDTree
    sample_layer: Bytes
    gap: Lattice | None
    socket: Lattice | None

    def distance(self, points: Floats) -> Floats:
        """Distance [m], shape (n,), of points [m], shape (n, 3), from the layers and the socket, negative inside."""
        away = triangle_distance(*self.union, points)
        if self.socket is not None:
            away = np.minimum(away, self.socket(points, beyond=1.0))
        return away.astype(points.dtype)

    def sample(self, grid: Grid) -> tuple[Singles, Singles]:
        """Fraction and depth of the voxels of a grid, see `meshes.shapes.anatomy.GridSampler`."""
        fraction, depth = TriangleSampler(*self.union)(grid)
        if self.gap is None and self.socket is None:
            return fraction, depth
        index = np.nonzero(fraction < 1.0)
        points = np.stack([(i + f + 0.5) * grid.spacing_m for i, f in zip(index, grid.first, strict=True)], axis=1)
        filled = fraction[index]
        if self.gap is not None:
            open_gap = Lattice(self.gap.origin, self.gap.pitch, (self.gap.values > 0).astype(np.float32))
            filled = np.minimum(filled + open_gap(points, beyond=0.0), 1.0)
        if self.socket is not None:
            away = self.socket(points, beyond=1.0)
            filled = filled + (1.0 - filled) * np.clip(0.5 - away / np.float32(grid.spacing_m), 0.0, 1.0)
            depth[index] = np.where(fraction[index] > 0.0, np.maximum(depth[index], -away), -away)
        fraction[index] = filled
        return fraction, depth

    def classify(self, points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Layer that holds the point, by priority; in none, the layer that takes the gap, or the nearest."""
        layer = np.full(len(points), len(TOOTH_LAYERS), dtype=np.uint8)
        left = np.arange(len(points))
        for index, (vertices, faces) in self.solids.items():
            held = inside_surface(vertices, faces, points[left])
            layer[left[held]] = index
            left = left[~held]
        if self.gap is not None:
            gap = self.gap.nearest(points[left])
            layer[left[gap > 0]] = gap[gap > 0] - 1
            left = left[gap == 0]
        away = np.full(len(left), np.inf) if self.socket is None else self.socket(points[left], beyond=1.0)
        layer[left[away <= 0.0]] = BONE
        left, away = left[away > 0.0], away[away > 0.0]
        distance, nearest = self.samples.query(points[left])
        layer[left] = np.where(away < distance, BONE, self.sample_layer[nearest])
        return layer, _DENSITY[layer]


def joined(solids: Sequence[Triangles]) -> Triangles:
    """One surface around several; triangles that two of them share back to back cancel."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in solids)])
    vertices = np.concatenate([vertices for vertices, _ in solids])
    faces = np.concatenate([faces + start for (_, faces), start in zip(solids, starts, strict=False)])
    return merge_vertices(vertices, faces, _MERGE_TOLERANCE_M)[:2]


def socket_lattice(ligament: Array, others: Array, margin: float) -> Lattice:
    """Distance [m] from the bone within `margin` of the ligament and nearer to it than to the rest of the tooth.

    Parameters
    ----------
    ligament, others
        Points of the ligament's surface and of those of the other layers [m], shape (n, 3).
    """
    from scipy.spatial import cKDTree

    low = ligament.min(axis=0) - margin - 2.0 * _SOCKET_PITCH_M
    count = np.ceil((ligament.max(axis=0) + margin + 2.0 * _SOCKET_PITCH_M - low) / _SOCKET_PITCH_M).astype(int) + 1
    points = low + _SOCKET_PITCH_M * np.moveaxis(np.indices(count), 0, -1).reshape(-1, 3)
    reach = margin + 2.0 * _SOCKET_PITCH_M
    away = np.minimum(cKDTree(ligament[::4]).query(points, distance_upper_bound=reach)[0], reach)
    near = np.flatnonzero(away < reach)
    signed = away - margin
    signed[near] = np.maximum(signed[near], away[near] - cKDTree(others[::4]).query(points[near])[0])
    return Lattice(low, _SOCKET_PITCH_M, signed.reshape(count).astype(np.float32))
