"""The bone a scene asks for, as voxels: procedural, or read from a file and placed at its site."""

from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress, silent
from meshes.shapes import sdf
from meshes.shapes.anatomy import Anatomy, cortical_block
from meshes.surfaces.glenoid import glenoid
from meshes.tooth.label_volume import LabelledTooth, labelled_tooth
from meshes.tooth.layered_surfaces import layered_surfaces
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.tooth.molar import molar
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise
from tissue.builders.bone_from_file import bone_from_file, require_whole, threshold_of
from tissue.builders.parts import FILE_WORDS
from tissue.cutters.cutter import Cutter
from tissue.motion.motion import Motion
from tissue.motion.reach import box_text, reach
from tissue.scene.anatomy import AnatomyFile, BlockAnatomy, GlenoidAnatomy, MolarAnatomy
from tissue.scene.scene import Scene

__all__ = ["volume_of", "whole_tooth"]

DENSE_BYTES_PER_VOXEL = 16
"""Peak memory of a voxel of the region while bricks are made and results written, measured on the glenoid."""
BRICK = 8
"""The region is cut at whole bricks of the world's lattice, so that a voxel lies at the same place in any region; where
a tool only grazes voxels, float32 coordinates from another origin still decide otherwise in single ticks."""


def whole_tooth(scene: Scene, *, spacing_m: float, report: Progress = silent) -> VoxelVolume:
    """The whole tooth that a scene describes, in coarser voxels, undrilled."""
    with _named(scene.bone):
        if scene.bone.file is not None:
            return _labelled(scene, spacing_m=spacing_m, notes={}, report=report)
        return voxelise(_anatomy(scene, {}), spacing_m=spacing_m)


def volume_of(scene: Scene, cutter: Cutter, motion: Motion, *, notes: dict[str, str], report: Progress) -> VoxelVolume:
    """Voxels of the bone that the tool can reach, with the guide hole drilled."""
    spacing = scene.voxels.spacing_mm * 1e-3
    parameters = scene.bone
    region = reach(cutter, motion, scene.voxels.margin_mm * 1e-3)
    if parameters.is_image and isinstance(parameters, BlockAnatomy) and parameters.centre_mm is None:
        with _named(parameters):
            return _image(scene, notes=notes)
    if isinstance(parameters, MolarAnatomy) and parameters.file is not None:
        with _named(parameters):
            return _labelled(scene, spacing_m=spacing, region=region, notes=notes, report=report)
    with _named(parameters):
        anatomy = _anatomy(scene, notes)
    require_whole(anatomy, region, is_image=parameters.is_image)
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
        progress=lambda share: report("voxelising", share),
    )


def _anatomy(scene: Scene, notes: dict[str, str]) -> Anatomy:
    """The procedural bone, or the one in a file placed at its site."""
    parameters = scene.bone
    if isinstance(parameters, MolarAnatomy) and parameters.layer_files:
        anatomy = layered_surfaces(
            parameters.layer_files,
            scale_mm=parameters.scale_mm,
            socket_mm=parameters.socket_mm,
            at_lesion=parameters.site == "caries",
        )
    elif parameters.file is not None:
        anatomy = bone_from_file(parameters, notes)
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


def _named(parameters: AnatomyFile) -> AbstractContextManager[None]:
    """Let a refusal name the scene's key: geometry knows its arguments, not where a scene gives them."""
    keys = {name: f"anatomy.{name}" for name in type(parameters).model_fields}
    names = dict.fromkeys(FILE_WORDS, "anatomy.file") | keys
    layers = parameters.layer_files if isinstance(parameters, MolarAnatomy) else {}
    if layers:
        names |= {f"{layer} {word}": f"anatomy.{layer}_file" for layer in layers for word in FILE_WORDS}
        missing = "dentin" if "enamel" in layers else "enamel"
        names["paths_by_layer must give enamel and dentin"] = f"anatomy.{missing}_file must be given"
        names |= {"layers": "anatomy.enamel_file and anatomy.dentin_file", "pulp": "anatomy.pulp_file"}
    return names_of_caller(names | {"resample_mm": "voxels.spacing_mm"})


def _image(scene: Scene, *, notes: dict[str, str]) -> VoxelVolume:
    """Bone from an image volume as it is, the top of its block at z = 0."""
    from meshes.images.bone_image import read_volume

    parameters = scene.bone
    remarks: list[str] = []
    volume = read_volume(
        parameters.file or "",
        threshold=threshold_of(parameters),
        spacing_mm=parameters.spacing_mm,
        density_kg_m3=parameters.density_kg_m3 if isinstance(parameters, BlockAnatomy) else 1800.0,
        resample_mm=scene.voxels.spacing_mm,
        remark=remarks.append,
    )
    notes["image"] = " ".join(remarks) or f"{parameters.file}: {volume.shape} voxels"
    return volume


def _labelled(
    scene: Scene,
    *,
    spacing_m: float,
    region: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    notes: dict[str, str],
    report: Progress,
) -> VoxelVolume:
    """A tooth from a label volume, or the part of it in a box of the site's frame [m]."""
    remarks: list[str] = []
    file = Path(scene.bone.file or "")
    stamp = file.stat() if file.is_file() else None
    report("reading the label volume", 0.0)
    over_lesion = isinstance(scene.bone, MolarAnatomy) and scene.bone.site == "caries"
    tooth = _read_tooth(file, scene.bone.spacing_mm, over_lesion, stamp and (stamp.st_mtime_ns, stamp.st_size))
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


@lru_cache(maxsize=1)
def _read_tooth(
    file: Path, spacing_mm: float | None, over_lesion: bool, stamp: tuple[int, int] | None
) -> LabelledTooth:
    """The tooth of a label volume, kept for the next who asks: for the tool and for the stress the same is read."""
    from meshes.images.reading import read_image

    tooth = labelled_tooth(read_image(file, spacing_mm=spacing_mm, labels=True))
    return tooth.at_lesion() if over_lesion else tooth


def _lesion(tooth: LabelledTooth) -> str | None:
    """Where the caries of a whole tooth lies in the frame of its site, so that a motion can be aimed at it."""
    placed = tooth.placed
    at = np.argwhere(placed.layer == TOOTH_LAYERS.index("caries"))
    if len(at) == 0:
        return None
    points = 1e3 * ((at * placed.spacing - placed.origin) @ placed.rotation)
    low, high = (", ".join(f"{value:.3g}" for value in corner) for corner in (points.min(axis=0), points.max(axis=0)))
    return f"caries between ({low}) and ({high}) mm of the site"


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
