"""Bone surface extracted from voxels, with the layer and removed depth."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.voxels.volume import FULL, VoxelVolume

if TYPE_CHECKING:
    import pyvista

__all__ = [
    "bone_surface",
    "cut_out",
    "smooth_normals",
    "triangle_means",
    "with_depth",
    "with_layers",
]

INWARD_VOXELS = 0.75
"""Depth under the surface at which the layer is read [voxels].

It lies inside the voxel behind the surface.
"""


def bone_surface(volume: VoxelVolume, fraction: NDArray[np.uint8]) -> "pyvista.PolyData":
    """Return the closed surface at half-full voxels [mm], with outward normals (flying edges).

    The surface is interpolated between voxel centres. Bone that reaches the edge of the voxels is
    closed there, so faces appear where the region was cut out.

    Parameters
    ----------
    volume
        Gives the position and size of the voxels.
    fraction
        Bone in every voxel, 255 = full, uint8, shape (nx, ny, nz).
    """
    import pyvista
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    spacing = volume.spacing_m * 1e3
    padded = np.pad(fraction, 1)
    image = pyvista.ImageData(
        dimensions=padded.shape,
        spacing=(spacing,) * 3,
        origin=volume.origin_m * 1e3 - 0.5 * spacing,
    )
    image.point_data["fraction"] = padded.ravel(order="F")
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


def triangle_means(values: ArrayLike, triangles: ArrayLike) -> NDArray[np.floating]:
    """Return the means over the three points of every triangle, shape (triangles, 3)."""
    first, second, third = np.asarray(triangles).T
    values = np.asarray(values)
    return np.asarray((values[first] + values[second] + values[third]) / values.dtype.type(3.0))


def with_depth(
    surface: "pyvista.PolyData",
    volume: VoxelVolume,
    remaining: NDArray[np.uint8],
    *,
    depth_mm: NDArray[np.float64],
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
    bare = np.clip(missing / (0.25 * FULL), 0.0, 1.0)
    surface.point_data["removed_depth_mm"] = (bare * columns).astype(np.float32)
    return surface


def smooth_normals(surface: "pyvista.PolyData", *, passes: int = 16) -> NDArray[np.float32]:
    """Return unit normals averaged over neighbours, shape (n, 3).

    A picture then shows the bone rather than its voxels. Neighbours are weighted by how well their
    normals agree; across an edge they are ignored.
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
    reach_m: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.bool_]:
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
    near = 0.25 * volume.spacing_m
    for corner, asked, side in zip(volume.bounds_m, reach_m, (-1.0, 1.0), strict=True):
        for axis in np.flatnonzero(np.abs(corner - asked) < 1.5 * volume.spacing_m):
            along = np.asarray(surface.points)[:, axis] * 1e-3
            cut |= (side * (along - corner[axis]) > -near)[surface.regular_faces].all(axis=1)
    return cut


def _voxels(points_mm: NDArray[np.floating], volume: VoxelVolume) -> NDArray[np.float64]:
    """Return positions in voxels, with centres at whole numbers, shape (n, 3)."""
    return (
        np.asarray(points_mm, dtype=np.float64) * 1e-3 - volume.origin_m
    ) / volume.spacing_m - 0.5
