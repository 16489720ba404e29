"""The bone a scene asks for, as voxels: procedural, or read from a file and placed at its site."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes import sdf
from meshes.anatomy import Anatomy, cortical_block
from meshes.errors import InputError
from meshes.glenoid import glenoid
from meshes.label_volume import label_volume
from meshes.layered_surfaces import layered_surfaces
from meshes.molar import molar
from meshes.progress import Progress
from meshes.volume import VoxelVolume
from meshes.voxelise import voxelise
from tissue.cutters import Cutter
from tissue.motion import Motion
from tissue.reach import box_text, reach
from tissue.scene import Scene
from tissue.scene_anatomy import AnatomyFile, BlockAnatomy, GlenoidAnatomy, MolarAnatomy

__all__ = ["volume_of", "whole_tooth"]

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
DENSE_BYTES_PER_VOXEL = 16
"""Peak memory of a voxel of the region while bricks are made and results written, measured on the glenoid."""
BRICK = 8
"""The region is cut at whole bricks of the world's lattice, so that a voxel lies at the same place in any region; where
a tool only grazes voxels, float32 coordinates from another origin still decide otherwise in single ticks."""


def whole_tooth(scene: Scene, *, spacing_m: float) -> VoxelVolume:
    """The whole tooth that a scene describes, in coarser voxels, undrilled."""
    with _named(scene.bone):
        if scene.bone.file is not None:
            return _labelled(scene, spacing_m=spacing_m, notes={})
        return voxelise(_anatomy(scene, {}), spacing_m=spacing_m)


def volume_of(scene: Scene, cutter: Cutter, motion: Motion, *, notes: dict[str, str], tell: Progress) -> VoxelVolume:
    """Voxels of the bone that the tool can reach, with the guide hole drilled."""
    spacing = scene.voxels.spacing_mm * 1e-3
    parameters = scene.bone
    region = reach(cutter, motion, scene.voxels.margin_mm * 1e-3)
    if _is_image(parameters) and isinstance(parameters, BlockAnatomy) and parameters.centre_mm is None:
        with _named(parameters):
            return _image(scene, notes=notes)
    if isinstance(parameters, MolarAnatomy) and parameters.file is not None:
        with _named(parameters):
            return _labelled(scene, spacing_m=spacing, notes=notes).cropped(*region)
    with _named(parameters):
        anatomy = _anatomy(scene, notes)
    bone = np.array(anatomy.shape.lower_m), np.array(anatomy.shape.upper_m)
    low = np.maximum(region[0], bone[0])
    high = np.minimum(region[1], bone[1])
    if (low >= high).any():
        raise InputError(
            "motion must bring the tool to the bone, got one that with the tool and a margin reaches from "
            f"{box_text(region)}: move it to the bone {box_text(bone, between=True)}"
        )
    brick = BRICK * spacing
    low, high = brick * np.floor(low / brick + 1e-6), brick * np.ceil(high / brick - 1e-6)
    _require_memory(high - low, spacing)
    return voxelise(
        anatomy,
        spacing_m=spacing,
        region_m=(low, high),
        minus=_guide_hole(scene, motion),
        progress=lambda share: tell("voxelising", share),
    )


def _anatomy(scene: Scene, notes: dict[str, str]) -> Anatomy:
    """The procedural bone, or the one in a surface file placed at its site."""
    parameters = scene.bone
    if isinstance(parameters, MolarAnatomy) and parameters.layer_files:
        anatomy = layered_surfaces(parameters.layer_files, scale_mm=parameters.scale_mm, socket_mm=parameters.socket_mm)
    elif parameters.file is not None:
        from meshes.image_file import read_image
        from meshes.image_surface import image_surface
        from meshes.site import find_glenoid, surface_anatomy
        from meshes.surface import read_surface

        if _is_image(parameters):
            image = read_image(parameters.file, spacing_mm=parameters.spacing_mm)
            notes["image"] = " ".join(image.notes)
            surface = image_surface(image, threshold=_threshold(parameters))
        else:
            surface = read_surface(parameters.file, scale_mm=parameters.scale_mm)
        site = find_glenoid(surface, centre_mm=parameters.centre_mm, normal=parameters.normal)
        anatomy = surface_anatomy(surface, site, cortical_thickness_mm=parameters.cortical_thickness_mm)
    elif isinstance(parameters, MolarAnatomy):
        anatomy = molar(
            crown_width_mm=parameters.crown_width_mm,
            crown_length_mm=parameters.crown_length_mm,
            enamel_thickness_mm=parameters.enamel_thickness_mm,
            pulp_roof_mm=parameters.pulp_roof_mm,
            ligament_thickness_mm=parameters.ligament_thickness_mm,
            caries_depth_mm=parameters.caries_depth_mm,
            caries_diameter_mm=parameters.caries_diameter_mm,
        )
    elif isinstance(parameters, GlenoidAnatomy):
        anatomy = glenoid(
            width_mm=parameters.width_mm,
            height_mm=parameters.height_mm,
            curvature_radius_mm=parameters.curvature_radius_mm,
            subchondral_thickness_mm=parameters.subchondral_thickness_mm,
        )
    else:
        assert isinstance(parameters, BlockAnatomy)
        anatomy = cortical_block(size_mm=parameters.size_mm, density_kg_m3=parameters.density_kg_m3)
    notes.update(anatomy.notes)
    return anatomy


@contextmanager
def _named(parameters: AnatomyFile) -> Iterator[None]:
    """Let a refusal name the scene's key: geometry knows its arguments, not where a scene gives them."""
    try:
        yield
    except InputError as error:
        said = str(error)
        argument = said.split(" ", 1)[0]
        if argument in ("resample_mm", "paths_by_layer"):
            key = "voxels.spacing_mm" if argument == "resample_mm" else "anatomy.enamel_file and its like"
            said = key + said.removeprefix(argument)
        elif argument.split("[")[0] in type(parameters).model_fields:
            said = f"anatomy.{said}"
        raise InputError(said) from error


def _is_image(parameters: AnatomyFile) -> bool:
    """Whether the anatomy comes from an image volume or a folder of slices."""
    return parameters.file is not None and Path(parameters.file).suffix.lower() not in SURFACE_SUFFIXES


def _threshold(parameters: AnatomyFile) -> float:
    """Grey value of an image above which a voxel is bone."""
    if parameters.threshold is None:
        raise InputError(
            f"anatomy.threshold must be given for an image, got nothing for {parameters.file}: "
            "set the grey value above which a voxel is bone"
        )
    return parameters.threshold


def _image(scene: Scene, *, notes: dict[str, str]) -> VoxelVolume:
    """Bone from an image volume as it is, the top of its block at z = 0."""
    from meshes.image import read_volume

    parameters = scene.bone
    said: list[str] = []
    volume = read_volume(
        parameters.file or "",
        threshold=_threshold(parameters),
        spacing_mm=parameters.spacing_mm,
        density_kg_m3=parameters.density_kg_m3 if isinstance(parameters, BlockAnatomy) else 1800.0,
        resample_mm=scene.voxels.spacing_mm,
        remark=said.append,
    )
    notes["image"] = " ".join(said) or f"{parameters.file}: {volume.shape} voxels"
    return volume


def _labelled(scene: Scene, *, spacing_m: float, notes: dict[str, str]) -> VoxelVolume:
    """A tooth from a label volume."""
    said: list[str] = []
    volume = label_volume(
        scene.bone.file or "", spacing_mm=scene.bone.spacing_mm, resample_mm=1e3 * spacing_m, remark=said.append
    )
    notes["labels"] = " ".join(said)
    return volume


def _guide_hole(scene: Scene, motion: Motion) -> sdf.Shape | None:
    """The hole that guides the peg: along the tool's first axis, from above the face to its depth."""
    diameter, depth = scene.bone.guide_hole_diameter_mm * 1e-3, scene.bone.guide_hole_depth_mm * 1e-3
    if diameter == 0.0 or depth == 0.0:
        return None
    axis, tip = motion.rotations()[0][:, 2], motion.sweep_m()[0]
    on_face = tip - axis * float(tip @ axis)
    return sdf.cylinder(0.5 * diameter, tuple(on_face - depth * axis), tuple(on_face + 0.05 * axis))


def _require_memory(size: NDArray[np.float64], spacing: float) -> None:
    """Refuse a grid that would not fit the memory that is free now."""
    import psutil

    needed = float(np.prod(size)) / spacing**3 * DENSE_BYTES_PER_VOXEL
    free = psutil.virtual_memory().available
    if needed > 0.9 * free:
        fits = spacing * (needed / (0.8 * free)) ** (1.0 / 3.0)
        raise InputError(
            f"voxels.spacing_mm must leave the bone within the free memory of {free / 1e9:.1f} GB, got "
            f"{spacing * 1e3:g} which needs {needed / 1e9:.1f} GB: use {np.ceil(fits * 1e5) / 100:g}"
        )
