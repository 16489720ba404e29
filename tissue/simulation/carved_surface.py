"""Surface of a bone that a tool carves.

The part that never changes is extracted once; the changing part is extracted at every moment.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.voxels.volume import FULL, VoxelVolume
from tissue.simulation.bone_surface import bone_surface, triangle_means, with_depth, with_layers

if TYPE_CHECKING:
    import pyvista

__all__ = ["Box", "CarvedSurface", "block_means", "changed_box", "coarse_volume"]

Box = tuple[NDArray[np.intp], NDArray[np.intp]]
MARGIN = 2
"""Margin around the voxels that change [voxels].

With it, normals at their edge equal the normals of the whole bone.
"""


class CarvedSurface:
    """Surface of a bone in which only a box of voxels changes.

    Parameters
    ----------
    volume
        The bone before the first cut, or some layers of it.
    box
        First and one after the last voxel that changes, shape (3,) each, see `changed_box`.
    axis
        World axis closest to the tool's, along which the removed depth is measured, 0 to 2.

    Attributes
    ----------
    part
        Slices of the volume's arrays that `of` needs.
    """

    def __init__(self, volume: VoxelVolume, box: Box, *, axis: int) -> None:
        low, high = box
        first = np.maximum(low - MARGIN, 0)
        last = np.minimum(high + MARGIN, volume.shape)
        self.part = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        self._whole = volume
        self._axis = axis
        self._cut = VoxelVolume(
            volume.origin_m + volume.spacing_m * first,
            volume.spacing_m,
            np.ascontiguousarray(volume.fraction[self.part]),
            np.ascontiguousarray(volume.layer[self.part]),
            np.ascontiguousarray(volume.density_kg_m3[self.part]),
            volume.layer_names,
        )
        spacing = 1e3 * volume.spacing_m
        origin = 1e3 * volume.origin_m
        self._low_mm = origin + spacing * (low - 0.5)
        self._high_mm = origin + spacing * (high + 0.5)

    def rest(self) -> "pyvista.PolyData":
        """Return the surface that no cut changes [mm].

        It has the cell array ``layer`` and the point arrays ``Normals`` and ``removed_depth_mm``,
        which is 0 everywhere.
        """
        surface = bone_surface(self._whole, self._whole.fraction)
        if not surface.n_cells:
            return surface
        with_layers(surface, self._whole)
        surface.point_data["removed_depth_mm"] = np.zeros(surface.n_points, dtype=np.float32)
        return _chosen(surface, ~self._inside(surface))

    def of(self, fraction: NDArray[np.uint8]) -> "pyvista.PolyData":
        """Return the surface that cuts change [mm], for the bone left in `part` (255 = full).

        Its arrays are as for `rest`.
        """
        left = np.ascontiguousarray(fraction)
        surface = bone_surface(self._cut, left)
        if not surface.n_cells:
            return surface
        with_layers(surface, self._cut)
        removed = (self._cut.fraction - left).sum(axis=self._axis, dtype=np.int64)
        depth = removed * (1e3 * self._cut.spacing_m / FULL)
        with_depth(surface, self._cut, left, depth_mm=depth, axis=self._axis)
        return _chosen(surface, self._inside(surface))

    def _inside(self, surface: "pyvista.PolyData") -> NDArray[np.bool_]:
        """Return the triangles of the changing surface, shape (triangles,).

        They lie between centres of voxels of which at least one changes.
        """
        middle = triangle_means(surface.points, surface.regular_faces)
        return np.asarray(((middle > self._low_mm) & (middle < self._high_mm)).all(axis=1))


def changed_box(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> Box | None:
    """Return the box of voxels that differ; None where all are equal.

    It holds the first voxel and one after the last, shape (3,) each.
    """
    differ = before != after
    columns = differ.any(axis=2)
    ends = [
        np.flatnonzero(along)
        for along in (columns.any(axis=1), columns.any(axis=0), differ.any(axis=0).any(axis=0))
    ]
    if not ends[0].size:
        return None
    return np.array([one[0] for one in ends]), np.array([one[-1] + 1 for one in ends])


def coarse_volume(volume: VoxelVolume, block: int) -> VoxelVolume:
    """Return the bone in voxels of ``block`` times the edge.

    Each voxel has the layer and density at its middle.
    """
    if block == 1:
        return volume
    middle = tuple(slice(block // 2, None, block) for _ in range(3))
    fraction = block_means(volume.fraction, block)
    layer = np.zeros_like(fraction)
    density = np.zeros(fraction.shape, dtype=np.uint16)
    for target, source in ((layer, volume.layer[middle]), (density, volume.density_kg_m3[middle])):
        target[tuple(slice(n) for n in source.shape)] = source
    return VoxelVolume(
        volume.origin_m, block * volume.spacing_m, fraction, layer, density, volume.layer_names
    )


def block_means(fraction: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Return means over blocks of voxels; beyond the edge the fraction is zero."""
    if block == 1:
        return fraction
    nx, ny, nz = (-(-n // block) for n in fraction.shape)
    pad = [(0, block * n - m) for n, m in zip((nx, ny, nz), fraction.shape, strict=True)]
    sums = np.pad(fraction, pad).reshape(nx, block, -1).sum(axis=1, dtype=np.uint32)
    sums = sums.reshape(nx, ny, block, -1).sum(axis=2).reshape(nx, ny, nz, block).sum(axis=3)
    return np.rint(sums / block**3).astype(np.uint8)


def _chosen(surface: "pyvista.PolyData", chosen: NDArray[np.bool_]) -> "pyvista.PolyData":
    """Return selected triangles of a surface with their points and arrays."""
    import pyvista

    faces = surface.regular_faces[chosen]
    used = np.zeros(surface.n_points, dtype=bool)
    used[faces] = True
    place = np.cumsum(used) - 1
    part = pyvista.PolyData.from_regular_faces(np.asarray(surface.points)[used], place[faces])
    for name in ("Normals", "removed_depth_mm"):
        part.point_data[name] = np.asarray(surface.point_data[name])[used]
    part.cell_data["layer"] = np.asarray(surface.cell_data["layer"])[chosen]
    part.field_data["layer_names"] = list(surface.field_data["layer_names"])
    return part
