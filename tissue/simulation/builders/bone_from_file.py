"""Bone read from a file: a surface, an image, or a tooth in a label volume.

A surface is placed at its site; an image is used as it is.
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.base.progress import Progress
from meshes.shapes.anatomy import Anatomy
from meshes.tooth import label_volume
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.voxels.volume import VoxelVolume
from tissue.scene.anatomy import (
    Block,
    BlockImage,
    Bone,
    Glenoid,
    ImageAnatomy,
    MolarLabels,
    Placed,
    SurfaceAnatomy,
)
from tissue.simulation.builders.parts import FILE_WORDS

if TYPE_CHECKING:
    from meshes.surfaces.site import Site
    from meshes.surfaces.surface import Surface

__all__ = ["Corners", "bone_from_file", "box_text", "labelled_tooth", "whole_image"]


Corners = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Lowest and highest corner of a box [m]."""


def bone_from_file(parameters: Placed, notes: dict[str, str]) -> Anatomy:
    """Return the bone in a surface or image, placed at its site."""
    from meshes.images.bone_image import image_cuts, image_triangles
    from meshes.images.reading import read_image
    from meshes.surfaces.glenoid import surface_anatomy
    from meshes.surfaces.surface import surface_from_triangles
    from meshes.surfaces.triangle_files import read_triangles

    cuts: tuple[NDArray[np.float64], ...] = ()
    if isinstance(parameters, ImageAnatomy):
        threshold = _threshold(parameters)
        image = read_image(parameters.file, spacing_mm=parameters.spacing_mm)
        triangles = image_triangles(image, threshold=threshold)
        source = image.source
        cuts = image_cuts(image, threshold=threshold)
        places = f"{len(cuts)} places" if len(cuts) > 1 else "one place"
        remarks = [
            *image.notes,
            *([f"The bone is cut off at {places} by the edge of the image."] if cuts else []),
        ]
        if remarks:
            notes["image"] = " ".join(remarks)
    else:
        file = Path(parameters.file)
        triangles = read_triangles(file)
        source = file.name
    scale_mm = parameters.scale_mm if isinstance(parameters, SurfaceAnatomy) else 1.0
    surface = surface_from_triangles(*triangles, source=source, scale_mm=scale_mm, cut_off=True)
    surface, site = replace(surface, caps_m=surface.caps_m + cuts), _site(parameters, surface)
    if isinstance(parameters, Bone) and (parameters.density_file or parameters.core_file):
        return _filled(parameters, surface, site)
    return surface_anatomy(
        surface,
        site,
        cortical_thickness_mm=parameters.cortical_thickness_mm,
        cortical_density_kg_m3=parameters.density_kg_m3
        if isinstance(parameters, Block)
        else 1800.0,
    )


def _filled(parameters: Bone, surface: "Surface", site: "Site") -> Anatomy:
    """Return a bone whose interior is known from CT density or a surface around its core."""
    from meshes.ct.bone_inside import cored_anatomy, imaged_anatomy, stated_law
    from meshes.images.reading import read_image
    from meshes.surfaces.surface import read_surface

    if parameters.density_file is None:
        with names_of_caller(dict.fromkeys(FILE_WORDS, "anatomy.core_file")):
            core = read_surface(
                parameters.core_file or "", scale_mm=surface.report.scale_mm, cut_off=True
            )
        return cored_anatomy(surface, core, site)
    with names_of_caller(dict.fromkeys(FILE_WORDS, "anatomy.density_file")):
        density = read_image(parameters.density_file)
    anatomy = imaged_anatomy(
        surface,
        site,
        density,
        cortical_above_kg_m3=parameters.cortical_above_kg_m3,
        articular_radius_mm=parameters.articular_radius_mm,
    )
    law = stated_law(Path(parameters.density_file))
    return replace(anatomy, notes={**anatomy.notes, "density law": law}) if law else anatomy


def whole_image(parameters: BlockImage, *, spacing_mm: float, notes: dict[str, str]) -> VoxelVolume:
    """Return the bone of an image volume as it is, with the top of its block at z = 0."""
    from meshes.images.bone_image import image_volume
    from meshes.images.reading import read_image

    remarks: list[str] = []
    threshold = _threshold(parameters)
    volume = image_volume(
        read_image(parameters.file, spacing_mm=parameters.spacing_mm),
        threshold=threshold,
        density_kg_m3=parameters.density_kg_m3,
        resample_mm=spacing_mm,
        remark=remarks.append,
    )
    notes["image"] = " ".join(remarks) or f"{parameters.file}: {volume.shape} voxels"
    return volume


def labelled_tooth(
    parameters: MolarLabels,
    *,
    spacing_m: float,
    region: Corners | None = None,
    notes: dict[str, str],
    report: Progress,
) -> VoxelVolume:
    """Read a tooth from a label volume, or the part of it in a box of the site's frame [m]."""
    remarks: list[str] = []
    file = Path(parameters.file)
    stamp = file.stat() if is_file(file) else None
    report("reading the label volume", 0.0)
    over_lesion = parameters.site == "caries"
    tooth = _read_tooth(
        file, parameters.spacing_mm, over_lesion, stamp and (stamp.st_mtime_ns, stamp.st_size)
    )
    volume = tooth.volume(
        resample_mm=1e3 * spacing_m,
        region_m=region,
        remark=remarks.append,
        progress=lambda share: report("voxelising the tooth", share),
    )
    notes["labels"] = " ".join(remarks)
    if (found := _lesion(tooth)) is not None:
        notes["lesion"] = found
    return volume


def box_text(corners: Corners, *, between: bool = False) -> str:
    """Return text for a box: its extent, or the region between its corners [mm]."""
    low, high = (
        "(" + ", ".join(f"{1e3 * value:.4g}" for value in corner) + ")" for corner in corners
    )
    return f"between {low} and {high} mm" if between else f"{low} to {high} mm"


def _site(parameters: Placed, surface: "Surface") -> "Site":
    """Return the site on a bone surface.

    The scene gives it; a glenoid without a given normal is searched for.
    """
    from meshes.surfaces.landmarks import find_glenoid
    from meshes.surfaces.site import place_site

    centre = parameters.centre_mm
    normal = parameters.normal
    along = parameters.along
    if isinstance(parameters, Glenoid) and normal is None:
        return find_glenoid(surface, centre_mm=centre, along=along)
    if centre is None:
        box = surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)
        raise InputError(
            "anatomy.centre_mm",
            f"be given for {parameters.file}",
            "none",
            (
                f"give a point on its surface, which lies {box_text(box, between=True)}, and "
                "anatomy.normal, or use anatomy.kind = glenoid"
            ),
        )
    return place_site(surface, centre_mm=centre, normal=normal, along=along)


def _threshold(parameters: ImageAnatomy) -> float:
    """Return the grey value of an image above which a voxel is bone."""
    from meshes.images.reading import require_image_name

    if parameters.threshold is None:
        require_image_name(Path(parameters.file))
        raise InputError(
            "anatomy.threshold",
            "be given for an image",
            f"nothing for {parameters.file}",
            "set the grey value above which a voxel is bone",
        )
    return parameters.threshold


@lru_cache(maxsize=1)
def _read_tooth(
    file: Path, spacing_mm: float | None, over_lesion: bool, stamp: tuple[int, int] | None
) -> label_volume.LabelledTooth:
    """Read the tooth of a label volume and keep it for the next call.

    The tool and the stress model read the same tooth.
    """
    from meshes.ct.labels import header_names
    from meshes.images.reading import read_image

    image = read_image(file, spacing_mm=spacing_mm, labels=True)
    named = header_names(file)
    known = named if set(named.values()) & set(TOOTH_LAYERS) else label_volume.CARIES_LABELS
    tooth = label_volume.labelled_tooth(image, labels=known)
    return tooth.at_lesion() if over_lesion else tooth


def _lesion(tooth: label_volume.LabelledTooth) -> str | None:
    """Return text for the extent of a whole tooth's caries in the frame of its site.

    It helps to aim a motion at the caries. None is returned for a tooth without caries.
    """
    placed = tooth.placed
    at = np.argwhere(placed.layer == TOOTH_LAYERS.index("caries"))
    if len(at) == 0:
        return None
    points = 1e3 * ((at * placed.spacing - placed.origin) @ placed.rotation)
    low, high = (
        ", ".join(f"{value:.3g}" for value in corner)
        for corner in (points.min(axis=0), points.max(axis=0))
    )
    return f"caries between ({low}) and ({high}) mm of the site"
