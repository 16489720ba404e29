"""The bone in a surface or image file: placed at its site, refused where its scan ends within the tool's reach."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.shapes.anatomy import Anatomy
from tissue.motion.reach import Corners, box_text
from tissue.scene.anatomy import AnatomyFile, BlockAnatomy, GlenoidAnatomy

if TYPE_CHECKING:
    from meshes.surfaces.site import Site
    from meshes.surfaces.surface import Surface

__all__ = ["bone_from_file", "require_whole", "threshold_of"]


def bone_from_file(parameters: AnatomyFile, notes: dict[str, str]) -> Anatomy:
    """The bone in a surface or image, placed at its site."""
    from meshes.images.reading import read_image
    from meshes.images.threshold_surface import image_cuts, image_triangles
    from meshes.surfaces.bone_surface import surface_anatomy
    from meshes.surfaces.surface import read_triangles, surface_from_triangles

    assert parameters.file is not None
    cuts: tuple[NDArray[np.float64], ...] = ()
    if parameters.is_image:
        image, threshold = read_image(parameters.file, spacing_mm=parameters.spacing_mm), threshold_of(parameters)
        triangles, source = image_triangles(image, threshold=threshold), image.source
        cuts = image_cuts(image, threshold=threshold)
        places = f"{len(cuts)} places" if len(cuts) > 1 else "one place"
        remarks = [*image.notes, *([f"The bone is cut off at {places} by the edge of the image."] if cuts else [])]
        if remarks:
            notes["image"] = " ".join(remarks)
    else:
        file = Path(parameters.file)
        triangles, source = read_triangles(file), file.name
    scale_mm = 1.0 if parameters.is_image else parameters.scale_mm
    surface = surface_from_triangles(*triangles, source=source, scale_mm=scale_mm, cut_off=True)
    return surface_anatomy(
        replace(surface, caps_m=surface.caps_m + cuts),
        _site(parameters, surface),
        cortical_thickness_mm=parameters.cortical_thickness_mm,
        cortical_density_kg_m3=parameters.density_kg_m3 if isinstance(parameters, BlockAnatomy) else 1800.0,
    )


def require_whole(anatomy: Anatomy, region: Corners, *, is_image: bool) -> None:
    """Refuse bone that the edge of its scan cuts off where the tool goes."""
    how, remedy = (
        ("with a hole", "close it in a mesh editor")
        if not is_image
        else (
            "cut off by the edge of the image",
            "take an image that holds more of the bone",
        )
    )
    for points in anatomy.caps_m:
        low, high = points.min(axis=0), points.max(axis=0)
        if (low <= region[1]).all() and (high >= region[0]).all() and not _outside(points, region):
            raise InputError(
                f"anatomy.file must enclose a solid where the tool goes, got {anatomy.name} {how} "
                f"{box_text((low, high), between=True)} within the tool's reach {box_text(region)}: {remedy}, or move "
                "the site away from it"
            )


def _outside(points: NDArray[np.float64], region: Corners) -> bool:
    """Whether a box lies all on one side of a cap, whose own box is wide where a cut is oblique."""
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    corners = np.array(np.meshgrid(*np.array(region).T)).reshape(3, -1).T
    cap, box = points @ normal, corners @ normal
    return bool(box.max() < cap.min() or box.min() > cap.max())


def _site(parameters: AnatomyFile, surface: "Surface") -> "Site":
    """The site on a bone surface: where the scene puts it, else the glenoid that it searches for."""
    from meshes.surfaces.site import find_glenoid, place_site

    centre, normal, along = parameters.centre_mm, parameters.normal, parameters.along
    if isinstance(parameters, GlenoidAnatomy) and normal is None:
        return find_glenoid(surface, centre_mm=centre, along=along)
    if centre is None:
        box = surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)
        raise InputError(
            f"anatomy.centre_mm must be given for {parameters.file}, got none: give a point on its surface, which lies "
            f"{box_text(box, between=True)}, and anatomy.normal, or use anatomy.kind = glenoid"
        )
    return place_site(surface, centre_mm=centre, normal=normal, along=along)


def threshold_of(parameters: AnatomyFile) -> float:
    """Grey value of an image above which a voxel is bone."""
    if parameters.threshold is None:
        raise InputError(
            f"anatomy.threshold must be given for an image, got nothing for {parameters.file}: "
            "set the grey value above which a voxel is bone"
        )
    return parameters.threshold
