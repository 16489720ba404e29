"""Source of a bone: its voxels, a surface to show, and notes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError, names_of_caller, require_range
from meshes.shapes.anatomy import Anatomy
from meshes.voxels.volume import VoxelVolume
from tissue.models.bone.bricks_on_demand import BricksOnDemand
from tissue.scene.part import SURFACE_SUFFIXES

if TYPE_CHECKING:
    import pyvista

__all__ = ["BoneSource", "anatomy_source", "image_source", "surface_source"]

SHOWN_VOXELS = 4e6
"""Largest number of voxels for drawing the surface of a bone given by a formula.

The surface is drawn before the bone is cut.
"""
KEY = "anatomy."
"""Prefix that readers add to the keys of a scene."""


@dataclass(frozen=True)
class BoneSource:
    """Source that makes an uncut bone any number of times.

    Attributes
    ----------
    voxels
        Function that makes its voxels, or bricks that are made where a tool first reaches.
    outer
        Function that makes its surface before any cut [mm]; None where all voxels are made.
    notes
        Notes on findings and assumptions, by subject.
    density_kg_m3
        Density of a bone with one density, else None.
    """

    voxels: Callable[[], VoxelVolume | BricksOnDemand]
    outer: "Callable[[], pyvista.PolyData] | None" = None
    notes: Mapping[str, str] = field(default_factory=dict)
    density_kg_m3: float | None = None


def anatomy_source(
    anatomy: Anatomy, *, spacing_mm: float, outer: "Callable[[], pyvista.PolyData] | None" = None
) -> BoneSource:
    """Return an anatomy in its own frame, with voxels made where a tool reaches.

    `outer` is as for `BoneSource`.
    """
    spacing_m = 1e-3 * require_range("spacing_mm", spacing_mm, 1e-3, 5.0, "use about 0.1")

    def drawn() -> "pyvista.PolyData":
        """Return the surface of coarse voxels."""
        from meshes.voxels.voxelise import voxelise
        from tissue.simulation.bone_surface import bone_surface

        sides = np.subtract(anatomy.shape.upper_m, anatomy.shape.lower_m)
        coarse_m = max(spacing_m, float(np.prod(sides) / SHOWN_VOXELS) ** (1.0 / 3.0))
        volume = voxelise(anatomy, spacing_m=coarse_m)
        return bone_surface(volume, volume.fraction)

    notes = {name: note.replace(KEY, "") for name, note in anatomy.notes.items() if name != "site"}
    return BoneSource(lambda: BricksOnDemand(anatomy, spacing_m=spacing_m), outer or drawn, notes)


def surface_source(
    path: Path,
    *,
    spacing_mm: float,
    scale_mm: float | None,
    cortical_thickness_mm: float,
    cortical_density_kg_m3: float,
    trabecular_density_kg_m3: float,
) -> BoneSource:
    """Read a closed surface from a file, see `tissue.objects.bone.Bone.from_file`."""
    from meshes.surfaces.glenoid import surface_anatomy
    from meshes.surfaces.site import Site
    from meshes.surfaces.surface import read_surface

    if path.suffix.lower() not in SURFACE_SUFFIXES:
        raise InputError(
            "file",
            f"be a surface ({' '.join(SURFACE_SUFFIXES)})",
            path.name,
            "an image goes to Bone.from_image",
        )
    with names_of_caller({"anatomy.scale_mm": "scale_mm"}):
        surface = read_surface(path, scale_mm=scale_mm, cut_off=True)
    anatomy = surface_anatomy(
        surface,
        Site(np.zeros(3), np.eye(3), "the file's own frame"),
        cortical_thickness_mm=cortical_thickness_mm,
        cortical_density_kg_m3=cortical_density_kg_m3,
        trabecular_density_kg_m3=trabecular_density_kg_m3,
    )

    def outer() -> "pyvista.PolyData":
        """Return the triangles of the file."""
        import pyvista

        return pyvista.PolyData.from_regular_faces(
            1e3 * surface.vertices_m, surface.faces.astype(int)
        )

    return anatomy_source(anatomy, spacing_mm=spacing_mm, outer=outer)


def image_source(
    path: Path, *, threshold: float, density_kg_m3: float, spacing_mm: float | None
) -> BoneSource:
    """Read an image volume, see `tissue.objects.bone.Bone.from_image`.

    TIFF slices state no spacing: `spacing_mm` is then the spacing of their voxels.
    """
    from meshes.images.bone_image import image_volume
    from meshes.images.reading import read_image
    from meshes.images.tiff import tiff_slices

    remarks: list[str] = []
    names = {
        "anatomy.threshold": "threshold",
        "anatomy.spacing_mm": "spacing_mm",
        "resample_mm": "spacing_mm",
    }
    with names_of_caller(names):
        found = image_volume(
            read_image(path, spacing_mm=spacing_mm if tiff_slices(path) else None),
            threshold=threshold,
            density_kg_m3=density_kg_m3,
            resample_mm=spacing_mm,
            remark=remarks.append,
        )
    assert found.placement is not None
    volume = replace(
        found, origin_m=found.origin_m + 1e-3 * found.placement.origin_mm, placement=None
    )
    notes = {"image": " ".join(remarks).replace(KEY, "")} if remarks else {}
    return BoneSource(lambda: volume, notes=notes, density_kg_m3=density_kg_m3)
