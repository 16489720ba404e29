"""pyvista surfaces of a cut bone and of the removed bone."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.surfaces.repair import close_seams
from meshes.voxels.volume import VoxelVolume
from tissue.simulation.bone_surface import bone_surface as voxel_surface
from tissue.simulation.bone_surface import smooth_normals, with_layers
from tissue.simulation.builders.cutting import VoxelBone
from tissue.system.offscreen import quiet_without_display

if TYPE_CHECKING:
    import pyvista

MERGED = 1e-3
SEAM = 3.0
"""Largest distance between boundary loops to join [voxels]; `MERGED` is for points to merge.

Two parts of a surface are connected: the surface from the file, and the surface of the voxels near
the cut. `MERGED` allows for rounding. `SEAM` allows for the gap between the boundary loops of the
two parts. The value of `SEAM` is a design choice.
"""
NEAR = 0.5
AGREE = 0.8
"""Smallest cosine `AGREE` and largest distance `NEAR` [voxels] for the use of the file's normals.

A point of the voxel surface gets the normal of the nearest point of the file's surface under two
conditions. The distance between the points is at most `NEAR`, and the cosine of the angle between
the normals is at least `AGREE`. Where nothing was cut, the voxel surface is within half a voxel of
the file's surface. Across a sharp edge, the normals differ by more than 37 degrees.
"""


def bone_surface(bone: VoxelBone, outer: "pyvista.PolyData | None") -> "pyvista.PolyData":
    """Return the current surface of a bone [mm], with the cell array ``layer``.

    Parameters
    ----------
    bone
        The bone.
    outer
        Surface of the bone before any cut [mm]. It is used where the bone is not cut. None for a
        bone whose voxels were all made at the start.
    """
    if outer is None:
        volume, left = bone.whole
        return _whole(volume, left)
    parts = []
    middle_m = bone.bounds_m.mean(axis=0)
    outer = (
        _moved(outer, -middle_m)
        .clean(point_merging=True)
        .compute_normals(cell_normals=False, split_vertices=False)
    )
    whole = outer
    spacing_mm = 1e3 * bone.store.grid.spacing_m
    for made, left in bone.cut_parts():
        volume = replace(made, origin_m=made.origin_m - middle_m)
        outer = _without(outer, volume)
        part = voxel_surface(volume, left, closed=False)
        if part.n_cells:
            parts.append(
                _shaded(with_layers(part, volume), like=whole, within_mm=NEAR * spacing_mm)
            )
    outer.cell_data["layer"] = np.zeros(outer.n_cells, dtype=np.uint8)
    if parts:
        outer = _joined(outer, parts, spacing_mm)
    return _moved(outer, middle_m)


def _joined(
    outer: "pyvista.PolyData", parts: "list[pyvista.PolyData]", spacing_mm: float
) -> "pyvista.PolyData":
    """Join a file's surface and the surfaces of the cut regions into one closed surface."""
    import pyvista

    cut = parts[0].append_polydata(*parts[1:]) if parts[1:] else parts[0]
    cut = cut.clean(point_merging=True, absolute=True, tolerance=MERGED * spacing_mm)
    if not outer.n_cells:
        return cut
    outer = outer.triangulate().clean(point_merging=True)
    points = np.concatenate([outer.points, cut.points]).astype(np.float64)
    faces = np.concatenate([outer.regular_faces, cut.regular_faces + outer.n_points]).astype(
        np.int64
    )
    closed, triangles = close_seams(
        points, faces, first_part=outer.n_points, within=SEAM * spacing_mm
    )
    surface = pyvista.PolyData.from_regular_faces(closed, triangles.astype(int))
    layer = np.concatenate([outer.cell_data["layer"], cut.cell_data["layer"]])
    surface.cell_data["layer"] = np.pad(layer, (0, len(triangles) - len(layer)))
    normals = np.concatenate([outer.point_data["Normals"], cut.point_data["Normals"]])
    surface.point_data["Normals"] = np.pad(normals, ((0, len(closed) - len(normals)), (0, 0)))
    surface.point_data.active_normals_name = "Normals"
    return surface


def _moved(surface: "pyvista.PolyData", by_m: Array) -> "pyvista.PolyData":
    """Return a copy of a surface [mm] that is moved by `by_m` [m], in double precision.

    In single precision, coordinates far from the origin would be rounded too much.
    """
    moved = surface.copy()
    moved.points = np.asarray(surface.points, dtype=np.float64) + 1e3 * by_m
    return moved


def _whole(volume: VoxelVolume, fraction: Bytes, *, closed: bool = True) -> "pyvista.PolyData":
    """Return the shaded surface of a voxel volume [mm], with the cell array ``layer``."""
    near = replace(volume, origin_m=np.zeros(3))
    surface = voxel_surface(near, fraction, closed=closed)
    if surface.n_cells:
        surface = _shaded(with_layers(surface, near))
    return _moved(surface, volume.origin_m)


def removed_surface(bone: VoxelBone) -> "pyvista.PolyData":
    """Return the surface of the removed bone [mm], with the cell array ``layer``.

    The surface is empty before the first cut.
    """
    import pyvista

    parts = [bone.whole] if bone.on_demand is None else bone.cut_parts()
    closed = bone.on_demand is None
    made = [_whole(volume, volume.fraction - left, closed=closed) for volume, left in parts]
    surfaces = [surface for surface in made if surface.n_cells]
    if not surfaces:
        return pyvista.PolyData()
    whole = surfaces[0].append_polydata(*surfaces[1:]) if surfaces[1:] else surfaces[0]
    return whole.clean(
        point_merging=True, absolute=True, tolerance=MERGED * 1e3 * bone.store.grid.spacing_m
    )


def plot_surface(surface: "pyvista.PolyData", layer_names: tuple[str, ...], **options: Any) -> Any:
    """Show a surface coloured by layer; `options` are passed to pyvista's ``surface.plot``.

    Raises
    ------
    InputError
        If there is nothing to show.
    """
    from matplotlib.colors import ListedColormap

    from meshes.base.errors import InputError
    from tissue.show.figures.figure import BONE, layer_colours

    if not surface.n_cells:
        raise InputError(
            "bone", "have been cut to show what was removed", "an uncut bone", "cut the bone first"
        )
    look: dict[str, Any] = {"interpolation": "Phong", "show_axes": True}
    if len(layer_names) == 1:
        look |= {"color": BONE}
    else:
        look |= {
            "scalars": "layer",
            "cmap": ListedColormap(list(layer_colours(layer_names).values())),
            "clim": (-0.5, len(layer_names) - 0.5),
            "annotations": dict(enumerate(layer_names)),
            "scalar_bar_args": {"title": "layer", "n_labels": 0},
        }
    with quiet_without_display():
        return surface.plot(**(look | options))


def _shaded(
    surface: "pyvista.PolyData", *, like: "pyvista.PolyData | None" = None, within_mm: float = 0.0
) -> "pyvista.PolyData":
    """Set smooth normals on a voxel surface; where `like` is near, use the normals of `like`."""
    import pyvista

    if not surface.n_cells:
        return surface
    normals = smooth_normals(surface)
    if like is not None:
        points = pyvista.PolyData(np.asarray(surface.points))
        found = points.sample(like, tolerance=within_mm, pass_cell_data=False)
        there = np.asarray(found.point_data["vtkValidPointMask"]) > 0
        theirs = np.asarray(found.point_data["Normals"])
        there &= np.einsum("ij,ij->i", theirs, normals) > AGREE
        normals[there] = theirs[there]
    surface.point_data["Normals"] = normals
    surface.point_data.active_normals_name = "Normals"
    return surface


def _without(outer: "pyvista.PolyData", volume: VoxelVolume) -> "pyvista.PolyData":
    """Return the part of a surface outside the box of a volume's voxel centres [mm]."""
    if not outer.n_cells:
        return outer
    low = 1e3 * (volume.origin_m + 0.5 * volume.spacing_m)
    high = low + 1e3 * volume.spacing_m * (np.array(volume.shape) - 1)
    bounds = np.column_stack([low, high]).ravel().tolist()
    return outer.clip_box(bounds, invert=True).extract_surface(algorithm="dataset_surface")


class Removed:
    """Bone that tools have removed so far."""

    def __init__(self, bone: VoxelBone) -> None:
        self._bone = bone

    @property
    def by_layer_mm3(self) -> dict[str, float]:
        """Volume removed from each layer [mm3]."""
        volumes = 1e9 * self._bone.removed_m3
        return dict(zip(self._bone.store.grid.layer_names, volumes.tolist(), strict=True))

    @property
    def volume_mm3(self) -> float:
        """Volume removed from all layers [mm3]."""
        return sum(self.by_layer_mm3.values())

    def surface(self) -> "pyvista.PolyData":
        """Return the surface of the removed bone [mm], with the cell array ``layer``.

        The surface is empty before the first cut.
        """
        return removed_surface(self._bone)

    def plot(self, **options: Any) -> Any:
        """Show the removed bone, coloured by layer; `options` are passed to
        ``pyvista.PolyData.plot``.
        """
        return plot_surface(self.surface(), self._bone.store.grid.layer_names, **options)

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{volume:.4g} mm3 of {name}" for name, volume in self.by_layer_mm3.items()
        )
        return f"Removed({parts})"
