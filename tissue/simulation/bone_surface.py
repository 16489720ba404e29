"""Surface of a bone that is modelled by voxels, with the layers and the removed depth."""

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

INWARD_VOXELS = 0.75
"""Depth below a triangle of the surface at which the layer of the triangle is read [voxels].

A point at this depth lies inside the voxel behind the surface.
"""
Box = tuple[NDArray[np.intp], NDArray[np.intp]]
MARGIN = 2
"""Margin around the voxels that change during a run [voxels].

With this margin, the normals at the edge of the changing part of the surface equal the normals of
the whole surface.
"""
HALF = (FULL + 1) // 2
"""Smallest content of a voxel that counts as bone (255 = full)."""


def bone_surface(
    volume: VoxelVolume, fraction: Bytes, *, closed: bool = True
) -> "pyvista.PolyData":
    """Return the surface through half-full voxels [mm], with outward normals.

    The surface is interpolated between voxel centres (flying edges algorithm).

    Parameters
    ----------
    volume
        Volume with the position and size of the voxels.
    fraction
        Bone in each voxel, 255 = full, uint8, shape (nx, ny, nz).
    closed
        Whether the surface is closed where bone reaches the boundary of the volume. If True, the
        surface has additional faces where the voxels end inside a larger bone. If False, the
        surface is open there.
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
    """Add the cell array ``layer``: the layer of the bone below each triangle.

    The array contains indices into the layer names, which are stored as the field ``layer_names``.
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
    """Return the mean of the values at the three points of each triangle.

    For vectors at the points, the result has shape (triangles, 3).
    """
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

    At a point that the tool exposed, the array holds the depth of bone removed from the column of
    voxels through the point. The depth is 0 on the original surface of the bone. It is also 0 on
    faces where the voxels end inside a larger bone.

    Parameters
    ----------
    surface
        Surface of the bone in `remaining`, as returned by `bone_surface`.
    volume, remaining
        Bone before the first cut, and bone left in each voxel after the cuts.
    depth_mm
        Removed depth of each column of voxels along ``axis`` [mm], one value for each column.
    axis
        World axis closest to the tool's axis, 0 to 2.
    """
    from scipy.ndimage import map_coordinates

    at = _voxels(surface.points, volume).T
    # On an uncut surface no bone is missing. A cut surface runs through half-full voxels, so half a
    # voxel is missing.
    missing = map_coordinates(
        volume.fraction - remaining, at, order=1, mode="nearest", output=np.float32
    )
    columns = map_coordinates(depth_mm, np.delete(at, axis, axis=0), order=1, mode="nearest")
    # The limit between both cases is a quarter of a voxel. The depth increases gradually over this
    # distance.
    bare = np.clip(missing / (0.25 * FULL), 0.0, 1.0)
    surface.point_data["removed_depth_mm"] = (bare * columns).astype(np.float32)
    return surface


def smooth_normals(surface: "pyvista.PolyData", *, passes: int = 16) -> Singles:
    """Return unit normals averaged over neighbours, shape (n, 3).

    With these normals, a picture does not show the steps between voxels. The weight of a neighbour
    is the cosine of the angle between its normal and the normal at the point. Neighbours at an
    angle of more than 37 degrees, for example across an edge, are ignored. On a ball of binary
    voxels, 16 passes reduce the error of the normals from 16 to 6 degrees, and 32 passes to 5.7
    degrees.
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
    """Return a mask, shape (triangles,), of the triangles where the volume ends inside bone.

    Parameters
    ----------
    surface
        Closed surface of the bone in the volume.
    volume
        Volume of voxels.
    reach_m
        Lowest and highest corner of the region for which voxels were requested [m]. Where the
        volume does not reach the end of this region, the bone itself ends, and no triangle is
        selected.
    """
    cut = np.zeros(surface.n_cells, dtype=bool)
    # A face on the boundary of the volume is within 0.25 voxel of the boundary.
    near = 0.25 * volume.spacing_m
    for axis, side in cut_faces(volume, reach_m):
        corner = volume.bounds_m[max(side, 0)]
        along = np.asarray(surface.points)[:, axis] * 1e-3
        cut |= (side * (along - corner[axis]) > -near)[surface.regular_faces].all(axis=1)
    return cut


def cut_faces(volume: VoxelVolume, reach_m: tuple[Array, Array]) -> list[tuple[int, int]]:
    """Return the faces at which a volume ends inside bone.

    Each face is a pair: the index of the axis normal to the face, and -1 for the lower end or 1 for
    the upper end of the volume. The arguments are those of `cut_out`.
    """
    # The region is rounded outward to whole bricks (blocks of voxels). 1.5 voxels allow for the
    # rounding to whole voxels of other volumes. Where the volume ends before the requested corner,
    # the bone itself ends.
    rounded_m = 1.5 * volume.spacing_m
    return [
        (int(axis), side)
        for corner, asked, side in zip(volume.bounds_m, reach_m, (-1, 1), strict=True)
        for axis in np.flatnonzero(side * (corner - asked) > -rounded_m)
        if volume.fraction.take(0 if side < 0 else -1, axis=axis).max() >= HALF
    ]


def _voxels(points_mm: Floats, volume: VoxelVolume) -> Array:
    """Return positions in units of voxels, shape (n, 3); voxel centres are at whole numbers."""
    return (
        np.asarray(points_mm, dtype=np.float64) * 1e-3 - volume.origin_m
    ) / volume.spacing_m - 0.5


class CarvedSurface:
    """Surface of a bone in which only a box of voxels changes.

    Parameters
    ----------
    volume
        Bone before the first cut, or some layers of this bone.
    box
        Box of the voxels that change, as returned by `changed_box`.
    axis
        World axis closest to the tool's axis, 0 to 2. The removed depth is measured along this
        axis.

    Attributes
    ----------
    part
        Slices of an array with one value per voxel. They select the voxels that `of` needs.
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
        """Return the part of the surface that no cut changes [mm].

        The surface has the cell array ``layer``, and the point arrays ``Normals`` and
        ``removed_depth_mm``. The removed depth is 0 everywhere.
        """
        surface = bone_surface(self._whole, self._whole.fraction)
        if not surface.n_cells:
            return surface
        with_layers(surface, self._whole)
        surface.point_data["removed_depth_mm"] = np.zeros(surface.n_points, dtype=np.float32)
        return _chosen(surface, ~self._inside(surface))

    def of(self, fraction: Bytes) -> "pyvista.PolyData":
        """Return the part of the surface that cuts change [mm].

        `fraction` is the bone left in the voxels of `part` (255 = full).

        The surface has the same arrays as `rest`.
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
        """Return a mask, shape (triangles,), of the triangles in the part that cuts change.

        Such a triangle lies between the centres of voxels, at least one of which changes.
        """
        middle = triangle_means(surface.points, surface.regular_faces)
        return np.asarray(((middle > self._low_mm) & (middle < self._high_mm)).all(axis=1))


def changed_box(before: Bytes, after: Bytes) -> Box | None:
    """Return the box around the voxels that differ between two arrays; None if all are equal.

    The box is a pair: the first indices, shape (3,), and the last indices plus one, shape (3,).
    """
    from scipy.ndimage import find_objects

    boxes = find_objects((before != after).view(np.uint8))
    if not boxes:
        return None
    return np.array([each.start for each in boxes[0]]), np.array([each.stop for each in boxes[0]])


def coarse_volume(volume: VoxelVolume, block: int) -> VoxelVolume:
    """Return the bone in coarser voxels; their edge is ``block`` times the original edge.

    A coarse voxel has the layer and the density of the original voxel at its middle.
    """
    if block == 1:
        return volume
    middle = tuple(slice(block // 2, None, block) for _ in range(3))
    fraction = block_means(volume.fraction, block)
    # The last block may be incomplete and have no middle voxel. Its layer and density are then 0.
    short = np.subtract(fraction.shape, volume.layer[middle].shape)
    missing = [(0, count) for count in short.tolist()]
    layer = np.pad(volume.layer[middle], missing)
    density = np.pad(volume.density_kg_m3[middle], missing)
    return VoxelVolume(
        volume.origin_m, block * volume.spacing_m, fraction, layer, density, volume.layer_names
    )


def block_means(fraction: Bytes, block: int) -> Bytes:
    """Return the mean of each cube of voxels with an edge of ``block`` voxels.

    Voxels of a cube that lie outside the volume count as 0.
    """
    from skimage.measure import block_reduce

    return np.rint(block_reduce(fraction, block, np.mean)).astype(np.uint8)


def _chosen(surface: "pyvista.PolyData", chosen: Flags) -> "pyvista.PolyData":
    """Return a surface of the selected triangles, with the arrays of points and cells."""
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
    """Interface of a run from which the carved bone can be written.

    The class `tissue.simulation.run.Run` has this interface, both for a run that was just simulated
    and for a run read from a folder.
    """

    @property
    def scene(self) -> "Scene":
        """Scene of the run."""
        ...

    @property
    def parts(self) -> "Parts":
        """Objects that simulated the scene, such as the motion and the tissue model."""
        ...

    @property
    def trace(self) -> Table:
        """Trace of the run, one row per tick."""
        ...

    @property
    def poses(self) -> Array | None:
        """Poses of the tool in every tick; None if the poses were not saved."""
        ...

    @property
    def volume(self) -> VoxelVolume:
        """Voxels of the bone before the cut."""
        ...

    @property
    def remaining(self) -> Bytes:
        """Bone left in each voxel, 255 = full."""
        ...

    def replay(self) -> "CarvingReplay":
        """Return a replay of the carving."""
        ...


@dataclass(frozen=True)
class DepthMap:
    """Depth of bone removed from each column of voxels along one world axis.

    Attributes
    ----------
    axis, outward
        World axis closest to the tool's axis, 0 to 2, and the side from which the tool comes, +1 or
        -1.
    across
        World axes that belong to the first and the second index of `depth_mm`.
    depth_mm
        Depth of bone removed from each column, including undercuts [mm], shape (nu, nv).
    """

    axis: int
    outward: int
    across: tuple[int, int]
    depth_mm: Array


def depth_map(run: CarvedRun) -> DepthMap:
    """Return the depth of bone that a run removed from each column of voxels."""
    volume = run.volume
    axis, outward = facing(run.trace)
    first, second = (each for each in range(3) if each != axis)
    removed = (volume.fraction - run.remaining).sum(axis=axis, dtype=np.int64)
    depth_mm = removed * (1e3 * volume.spacing_m / FULL)
    return DepthMap(axis=axis, outward=outward, across=(first, second), depth_mm=depth_mm)


def tool_axes(quaternions: Array) -> Array:
    """Return directions of the tool's axis, shape (n, 3).

    The directions are the third columns of the rotation matrices of the quaternions (x, y, z, w).
    """
    x, y, z, w = quaternions.T
    return np.column_stack(
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)]
    )


def facing(trace: Table) -> tuple[int, int]:
    """Return the world axis closest to the tool's axis, and the side from which the tool comes.

    The axis is averaged over the ticks in contact, if there are any. The side is 1 if the tool
    comes from the positive end of the world axis, and -1 otherwise.
    """
    rows = trace["contact_mm2"] > 0.0
    quaternions = trace.quaternions()
    mean = tool_axes(quaternions[rows] if rows.any() else quaternions).mean(axis=0)
    axis = int(np.abs(mean).argmax())
    return axis, 1 if mean[axis] >= 0.0 else -1
