"""Surface of bone in voxels: its layers, the removed depth, and the part that cuts change."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array, Bytes, Flags, Floats, Singles
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.carver import CarvingReplay
    from tissue.scene.scene import Scene
    from tissue.simulation.builders.parts import Parts

__all__ = [
    "HALF",
    "Box",
    "CarvedRun",
    "CarvedSurface",
    "DepthMap",
    "block_means",
    "bone_surface",
    "changed_box",
    "coarse_volume",
    "cut_out",
    "depth_map",
    "facing",
    "smooth_normals",
    "tool_axes",
    "triangle_means",
    "with_depth",
    "with_layers",
]

INWARD_VOXELS = 0.75
"""Depth under the surface at which the layer is read [voxels].

It lies inside the voxel behind the surface.
"""
Box = tuple[NDArray[np.intp], NDArray[np.intp]]
MARGIN = 2
"""Margin around the voxels that change [voxels].

With it, normals at their edge equal the normals of the whole bone.
"""
HALF = (FULL + 1) // 2
"""Smallest filling of a voxel that counts as bone (255 = full)."""


def bone_surface(
    volume: VoxelVolume, fraction: Bytes, *, closed: bool = True
) -> "pyvista.PolyData":
    """Return the surface at half-full voxels [mm], with outward normals (flying edges).

    The surface is interpolated between voxel centres.

    Parameters
    ----------
    volume
        Gives the position and size of the voxels.
    fraction
        Bone in every voxel, 255 = full, uint8, shape (nx, ny, nz).
    closed
        Whether bone that reaches the edge of the voxels is closed there, so that faces appear where
        the region was cut out. Otherwise the surface is open there.
    """
    import pyvista
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    spacing = volume.spacing_m * 1e3
    origin = volume.origin_m * 1e3 + 0.5 * spacing
    if closed:
        fraction = np.pad(fraction, 1)
        origin = volume.origin_m * 1e3 - 0.5 * spacing
    image = pyvista.ImageData(dimensions=fraction.shape, spacing=(spacing,) * 3, origin=origin)
    image.point_data["fraction"] = fraction.ravel(order="F")
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 0.5 * FULL)
    edges.ComputeNormalsOn()
    edges.ComputeScalarsOff()
    edges.Update()
    surface: pyvista.PolyData = pyvista.wrap(edges.GetOutput())
    return surface


def with_layers(surface: "pyvista.PolyData", volume: VoxelVolume) -> "pyvista.PolyData":
    """Add the layer under every triangle as the cell array ``layer``.

    The layer names are stored as the field ``layer_names``.
    """
    triangles = surface.regular_faces
    points = surface.points
    normals = surface.point_data["Normals"]
    inward = INWARD_VOXELS * volume.spacing_m * 1e3
    under = triangle_means(points, triangles) - inward * triangle_means(normals, triangles)
    at = np.rint(_voxels(under, volume)).astype(np.intp)
    at = np.clip(at, 0, np.array(volume.shape) - 1)
    surface.cell_data["layer"] = volume.layer[at[:, 0], at[:, 1], at[:, 2]]
    surface.field_data["layer_names"] = list(volume.layer_names)
    return surface


def triangle_means(values: ArrayLike, triangles: ArrayLike) -> Floats:
    """Return the means over the three points of every triangle, shape (triangles, 3)."""
    first, second, third = np.asarray(triangles).T
    values = np.asarray(values)
    return np.asarray((values[first] + values[second] + values[third]) / values.dtype.type(3.0))


def with_depth(
    surface: "pyvista.PolyData",
    volume: VoxelVolume,
    remaining: Bytes,
    *,
    depth_mm: Array,
    axis: int,
) -> "pyvista.PolyData":
    """Add the point array ``removed_depth_mm``.

    At a point that the tool exposed, it is the depth of bone removed from the column through that
    point. It is 0 on the bone's original surface and on faces where the region was cut out.

    Parameters
    ----------
    surface
        Surface of ``remaining``.
    volume, remaining
        The bone before and after.
    depth_mm
        Removed depth of every column along ``axis`` [mm], shape of the other two axes.
    axis
        The tool's axis, 0 to 2.
    """
    from scipy.ndimage import map_coordinates

    at = _voxels(surface.points, volume).T
    # On an uncut surface nothing is missing. On a cut surface, which runs through half-full voxels,
    # half a voxel is missing.
    missing = map_coordinates(
        volume.fraction - remaining, at, order=1, mode="nearest", output=np.float32
    )
    columns = map_coordinates(depth_mm, np.delete(at, axis, axis=0), order=1, mode="nearest")
    # A quarter of a voxel separates both, and the depth fades in over it.
    bare = np.clip(missing / (0.25 * FULL), 0.0, 1.0)
    surface.point_data["removed_depth_mm"] = (bare * columns).astype(np.float32)
    return surface


def smooth_normals(surface: "pyvista.PolyData", *, passes: int = 16) -> Singles:
    """Return unit normals averaged over neighbours, shape (n, 3).

    A picture then shows the bone rather than its voxels. Neighbours are weighted by how well their
    normals agree; across an edge, where they differ by more than 37 degrees, they are ignored. On
    a ball of binary voxels, 16 passes reduce the error of the normals from 16 to 6 degrees, and 32
    to 5.7.
    """
    from scipy.sparse import csr_array

    triangles = surface.regular_faces
    normals = np.array(surface.point_data["Normals"], dtype=np.float32)
    first = triangles.ravel()
    second = np.roll(triangles, -1, axis=1).ravel()
    agree = np.einsum("ij,ij->i", normals[first], normals[second])
    weights = np.where(agree > 0.8, agree, np.float32(0.0))
    count = len(normals)
    neighbours = csr_array((weights, (first, second)), shape=(count, count))
    for _ in range(passes):
        normals = normals + neighbours @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-12))
    return normals


def cut_out(
    surface: "pyvista.PolyData",
    volume: VoxelVolume,
    reach_m: tuple[Array, Array],
) -> Flags:
    """Return the triangles that close bone continuing beyond the voxels, shape (triangles,).

    Parameters
    ----------
    surface
        Surface of bone in the volume.
    volume
        The voxels.
    reach_m
        Lowest and highest corner of the requested region. Where the voxels end before it, the bone
        itself ends.
    """
    cut = np.zeros(surface.n_cells, dtype=bool)
    # 1.5 voxels cover the rounding of the region to whole voxels. Where the volume ends farther
    # from the requested corner, the bone itself ends. A face on the boundary is within 0.25 voxel.
    near = 0.25 * volume.spacing_m
    for corner, asked, side in zip(volume.bounds_m, reach_m, (-1.0, 1.0), strict=True):
        for axis in np.flatnonzero(np.abs(corner - asked) < 1.5 * volume.spacing_m):
            along = np.asarray(surface.points)[:, axis] * 1e-3
            cut |= (side * (along - corner[axis]) > -near)[surface.regular_faces].all(axis=1)
    return cut


def _voxels(points_mm: Floats, volume: VoxelVolume) -> Array:
    """Return positions in voxels, with centres at whole numbers, shape (n, 3)."""
    return (
        np.asarray(points_mm, dtype=np.float64) * 1e-3 - volume.origin_m
    ) / volume.spacing_m - 0.5


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

    def of(self, fraction: Bytes) -> "pyvista.PolyData":
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

    def _inside(self, surface: "pyvista.PolyData") -> Flags:
        """Return the triangles of the changing surface, shape (triangles,).

        They lie between centres of voxels of which at least one changes.
        """
        middle = triangle_means(surface.points, surface.regular_faces)
        return np.asarray(((middle > self._low_mm) & (middle < self._high_mm)).all(axis=1))


def changed_box(before: Bytes, after: Bytes) -> Box | None:
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
        # A last, incomplete block may have no middle: its layer and density stay 0.
        target[tuple(slice(n) for n in source.shape)] = source
    return VoxelVolume(
        volume.origin_m, block * volume.spacing_m, fraction, layer, density, volume.layer_names
    )


def block_means(fraction: Bytes, block: int) -> Bytes:
    """Return means over blocks of voxels; beyond the edge the fraction is zero."""
    if block == 1:
        return fraction
    nx, ny, nz = (-(-n // block) for n in fraction.shape)
    pad = [(0, block * n - m) for n, m in zip((nx, ny, nz), fraction.shape, strict=True)]
    sums = np.pad(fraction, pad).reshape(nx, block, -1).sum(axis=1, dtype=np.uint32)
    sums = sums.reshape(nx, ny, block, -1).sum(axis=2).reshape(nx, ny, nz, block).sum(axis=3)
    return np.rint(sums / block**3).astype(np.uint8)


def _chosen(surface: "pyvista.PolyData", chosen: Flags) -> "pyvista.PolyData":
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


class CarvedRun(Protocol):
    """Run, either just simulated or read back; see `tissue.simulation.run.Run`."""

    @property
    def scene(self) -> "Scene":
        """Scene of the run."""
        ...

    @property
    def parts(self) -> "Parts":
        """Parts that were simulated."""
        ...

    @property
    def trace(self) -> Table:
        """Trace of the run, one row per tick."""
        ...

    @property
    def poses(self) -> Array | None:
        """Poses of the tool in every tick, or None if they were not saved."""
        ...

    @property
    def volume(self) -> VoxelVolume:
        """Voxels of the bone before the cut."""
        ...

    @property
    def remaining(self) -> Bytes:
        """Remaining bone in every voxel, 255 = full."""
        ...

    def replay(self) -> "CarvingReplay":
        """Return a replay of the carving."""
        ...


@dataclass(frozen=True)
class DepthMap:
    """Columns of voxels along the world axis closest to the tool's axis.

    Attributes
    ----------
    axis, outward
        World axis closest to the tool's axis, 0 to 2, and the side that the tool comes from, +1 or
        -1.
    across
        The two other axes: first and second index of the arrays.
    extent_mm
        Lowest and highest coordinate along the two axes, (u0, u1, v0, v1) [mm].
    depth_mm
        Bone removed from each column, undercuts included [mm], shape (nu, nv).
    height_mm
        Coordinate along `axis` of the bone's face after the run, within its voxel [mm]; NaN where
        no bone is left.
    bone
        Columns that held bone before the run.
    exposed
        By layer, columns whose face shows that layer after the run and another one before.
    """

    axis: int
    outward: int
    across: tuple[int, int]
    extent_mm: tuple[float, float, float, float]
    depth_mm: Array
    height_mm: Array
    bone: Flags
    exposed: dict[str, Flags]


def depth_map(run: CarvedRun) -> DepthMap:
    """Return removed depth, face and newly exposed layers of a run."""
    from scipy.ndimage import binary_opening

    volume = run.volume
    remaining = run.remaining
    axis, outward = facing(run.trace)
    across = [a for a in range(3) if a != axis]
    spacing = volume.spacing_m * 1e3
    origin = volume.origin_m * 1e3
    start = origin[axis] if outward > 0 else origin[axis] + spacing * volume.shape[axis]
    removed = (volume.fraction - remaining).sum(axis=axis, dtype=np.int64)
    bone, _, before = _face(volume.fraction, volume.layer, axis, outward)
    left, at, after = _face(remaining, volume.layer, axis, outward)
    # Single columns at the edge of a hole change their layer when their last voxel is removed. They
    # are not exposed bone.
    exposed = [
        (name, binary_opening(left & (after == index) & (before != index), np.ones((3, 3))))
        for index, name in enumerate(volume.layer_names)
    ]
    ends = [(origin[a], origin[a] + spacing * volume.shape[a]) for a in across]
    return DepthMap(
        axis=axis,
        outward=outward,
        across=(across[0], across[1]),
        extent_mm=(*ends[0], *ends[1]),
        depth_mm=removed * (spacing / FULL),
        height_mm=np.where(left, start + outward * spacing * at, np.nan),
        bone=bone,
        exposed={name: mask for name, mask in exposed if mask.any()},
    )


def tool_axes(quaternions: Array) -> Array:
    """Return directions of the tool's axis, shape (n, 3).

    They are the third columns of the rotations (x, y, z, w).
    """
    x, y, z, w = quaternions.T
    return np.column_stack(
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)]
    )


def facing(trace: Table) -> tuple[int, int]:
    """Return the world axis closest to the tool's axis while it cut, and its sign."""
    rows = trace["contact_mm2"] > 0.0
    quaternions = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
    mean = tool_axes(quaternions[rows] if rows.any() else quaternions).mean(axis=0)
    axis = int(np.abs(mean).argmax())
    return axis, 1 if mean[axis] >= 0.0 else -1


def _face(fraction: Bytes, layer: Bytes, axis: int, outward: int) -> tuple[Flags, Array, Bytes]:
    """Return the face of each column: whether it holds bone, its height, and its layer.

    The height counts voxels above the far end. The face lies in the first voxel from outside that
    is half full, or in the one above, depending on their filling.
    """
    seen = np.flip(fraction, axis) if outward > 0 else fraction
    first = np.argmax(seen >= HALF, axis=axis)
    at = fraction.shape[axis] - 1 - first if outward > 0 else first
    index = np.expand_dims(at, axis)
    above = np.clip(index + outward, 0, fraction.shape[axis] - 1)
    full = np.take_along_axis(fraction, index, axis).squeeze(axis)
    partial = np.where(above == index, 0, np.take_along_axis(fraction, above, axis)).squeeze(axis)
    height = fraction.shape[axis] - 1 - first + (full + partial.astype(np.float64)) / FULL
    return full >= HALF, height, np.take_along_axis(layer, index, axis).squeeze(axis)
