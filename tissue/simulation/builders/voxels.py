"""Voxels of a scene's bone that a tool can reach, and checks of its path through them."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial

import numpy as np
from numpy.typing import NDArray

from meshes.base.cache import Kept
from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress, silent
from meshes.paths.toolpath import arc_length, points_along
from meshes.shapes import sdf
from meshes.shapes.anatomy import Anatomy, cortical_block
from meshes.surfaces.glenoid import glenoid
from meshes.tooth.layered_surfaces import layered_surfaces
from meshes.tooth.molar import molar
from meshes.vertebra.lumbar import lumbar_vertebra
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import AROUND_VOXELS, voxelise
from tissue.cutters.cutter import Cutter
from tissue.motion.motion import Motion
from tissue.scene.anatomy import (
    BlockAnatomy,
    BlockImage,
    CutAnatomy,
    GlenoidAnatomy,
    ImageAnatomy,
    MolarAnatomy,
    MolarLabels,
    MolarSurfaces,
    Placed,
    Tooth,
    VertebraAnatomy,
)
from tissue.scene.scene import Scene
from tissue.simulation.builders.bone_from_file import (
    Corners,
    bone_from_file,
    box_text,
    labelled_tooth,
    whole_image,
)
from tissue.simulation.builders.parts import FILE_WORDS

__all__ = [
    "is_procedural",
    "reach",
    "require_outside",
    "require_touch",
    "require_whole",
    "solid_of",
    "structures",
    "swept_box",
    "volume_of",
    "whole_tooth",
]

POSES_TRIED = 300
"""Number of poses along a motion at which contact is searched for."""
DENSE_BYTES_PER_VOXEL = 18
"""Peak memory per voxel of the region [bytes], measured on the glenoid.

It is reached while bricks are made and results written.
"""
BRICK = 8
"""Edge of a brick [voxels].

The region is cut at whole bricks of the world's lattice, so a voxel lies at the same position in
any region. Where a tool only grazes voxels, float32 coordinates from another origin can still
change the result in single ticks.
"""


MOST_KEPT = 1e7
"""Number of voxels above which a volume is made anew for each run rather than kept: 60 MB."""
_volumes: Kept[VoxelVolume] = Kept(2)
"""Volumes of procedural bone, by its parameters, the region and the guide hole."""


def whole_tooth(scene: Scene, *, spacing_m: float, report: Progress = silent) -> VoxelVolume:
    """Return the whole tooth that a scene describes, in coarser voxels and undrilled."""
    parameters = scene.bone
    with _named(parameters):
        if isinstance(parameters, MolarLabels):
            return labelled_tooth(parameters, spacing_m=spacing_m, notes={}, report=report)
        return voxelise(_anatomy(parameters, {}), spacing_m=spacing_m)


def volume_of(
    scene: Scene, cutter: Cutter, motion: Motion, *, notes: dict[str, str], report: Progress
) -> VoxelVolume:
    """Return voxels of the bone that the tool can reach, with the guide hole drilled."""
    spacing = scene.voxels.spacing_mm * 1e-3
    parameters = scene.bone
    region = reach(cutter, motion, scene.voxels.margin_mm * 1e-3)
    with _named(parameters):
        if isinstance(parameters, BlockImage) and parameters.is_whole:
            return whole_image(parameters, spacing_mm=scene.voxels.spacing_mm, notes=notes)
        if isinstance(parameters, MolarLabels):
            return labelled_tooth(
                parameters, spacing_m=spacing, region=region, notes=notes, report=report
            )
        anatomy = _anatomy(parameters, notes)
    if anatomy.caps_m:
        require_whole(anatomy, region, is_image=isinstance(parameters, ImageAnatomy))
    bone = np.array(anatomy.shape.lower_m), np.array(anatomy.shape.upper_m)
    low = np.maximum(region[0], bone[0])
    high = np.minimum(region[1], bone[1])
    if (low >= high).any():
        raise InputError(
            "motion",
            "bring the tool to the bone",
            f"one that with the tool and a margin reaches from {box_text(region)}",
            f"move it to the bone {box_text(bone, between=True)}",
        )
    low, high = _covered(region, bone, spacing)
    _require_memory(region, bone, spacing)
    voxels = partial(
        voxelise,
        anatomy,
        spacing_m=spacing,
        region_m=(low, high),
        minus=_guide_hole(scene, motion),
        progress=lambda share: report("voxelising", share),
    )
    if not is_procedural(parameters) or np.prod((high - low) / spacing) > MOST_KEPT:
        return voxels()
    start = motion.sweep_m()[0].tobytes(), motion.rotations()[0].tobytes()
    return _volumes.of(
        (parameters.model_dump_json(), spacing, low.tobytes(), high.tobytes(), *start), voxels
    )


def is_procedural(parameters: CutAnatomy) -> bool:
    """Return whether an anatomy is procedural: a function of position, not from a file."""
    return type(parameters) in PROCEDURAL


def structures(scene: Scene) -> Mapping[str, sdf.Shape]:
    """Return structures of a scene's anatomy to keep a tool clear of, by name.

    An anatomy from files has no such structures.
    """
    return _anatomy(scene.bone, {}).structures if is_procedural(scene.bone) else {}


def solid_of(scene: Scene, motion: Motion) -> tuple[Anatomy, sdf.Shape | None]:
    """Return the anatomy that a scene cuts, and its guide hole, as functions of position.

    The guide hole is drilled before the run.

    Raises
    ------
    InputError
        If the anatomy comes from a file, where no such function is known.
    """
    parameters = scene.bone
    if not is_procedural(parameters):
        raise InputError(
            "anatomy",
            "be procedural to be known exactly",
            f"a {scene.anatomy.kind} from a file",
            "leave the file out",
        )
    return _anatomy(parameters, {}), _guide_hole(scene, motion)


PROCEDURAL: dict[type[CutAnatomy], Callable[..., Anatomy]] = {
    MolarAnatomy: molar,
    GlenoidAnatomy: glenoid,
    VertebraAnatomy: lumbar_vertebra,
    BlockAnatomy: cortical_block,
}
"""Functions that make an anatomy from the keys of its table."""
NO_SHAPE = {"kind", "guide_hole_diameter_mm", "guide_hole_depth_mm"}
"""Keys of an anatomy that do not affect its shape."""


def _anatomy(parameters: CutAnatomy, notes: dict[str, str]) -> Anatomy:
    """Return the procedural bone, or the one in a file placed at its site."""
    if isinstance(parameters, MolarSurfaces):
        anatomy = layered_surfaces(
            parameters.layer_files,
            scale_mm=parameters.scale_mm,
            socket_mm=parameters.socket_mm,
            at_lesion=parameters.site == "caries",
        )
    elif isinstance(parameters, Placed):
        anatomy = bone_from_file(parameters, notes)
    else:
        anatomy = PROCEDURAL[type(parameters)](**parameters.model_dump(exclude=NO_SHAPE))
    notes.update(anatomy.notes)
    return anatomy


def _named(parameters: CutAnatomy) -> AbstractContextManager[None]:
    """Make a refusal name the scene's key.

    Geometry functions know their arguments, not the key in which a scene gives them.
    """
    keys = {name: f"anatomy.{name}" for name in type(parameters).model_fields}
    names = dict.fromkeys(FILE_WORDS, "anatomy.file") | keys
    layers = parameters.layer_files if isinstance(parameters, Tooth) else {}
    if layers:
        names |= {
            f"{layer} {word}": f"anatomy.{layer}_file" for layer in layers for word in FILE_WORDS
        }
        both = "anatomy.enamel_file and anatomy.dentin_file"
        names |= {"paths_by_layer": both, "layers": both, "pulp": "anatomy.pulp_file"}
    return names_of_caller(names | {"resample_mm": "voxels.spacing_mm"})


def reach(cutter: Cutter, motion: Motion, margin: float) -> Corners:
    """Return a box around everything that the cutting surface can reach, with a margin [m]."""
    return swept_box(cutter.shell(spacing_m=cutter.profile.radius_m / 8.0).points_m, motion, margin)


def swept_box(shell: NDArray[np.float64], motion: Motion, margin: float) -> Corners:
    """Return a box around the reach of the tool's points, with a margin [m].

    The points [m] have shape (n, 3).
    """
    tips = motion.sweep_m()
    rotations = motion.rotations()
    starts = np.arange(0, len(tips), max(len(tips) // 500, 1))
    turned = [shell @ turn.T for turn in rotations[starts]]
    low = np.minimum.reduceat(tips, starts) + [points.min(axis=0) for points in turned]
    high = np.maximum.reduceat(tips, starts) + [points.max(axis=0) for points in turned]
    return low.min(axis=0) - margin, high.max(axis=0) + margin


def require_touch(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that never brings the cutting surface into bone."""
    shell = cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m
    corners = motion.sweep_m()
    rotations = motion.rotations()
    along = arc_length(corners)
    between = np.linspace(0.0, along[-1], POSES_TRIED)
    corners_on = along[:: len(along) // POSES_TRIED + 1]
    wanted = np.unique(np.concatenate([between, corners_on]))
    tips = points_along(corners, wanted)
    turns = rotations[np.searchsorted(along, wanted)]
    limits = np.array(volume.shape)
    for tip, turn in zip(tips[::-1], turns[::-1], strict=True):
        at = np.floor((tip + shell @ turn.T - volume.origin_m) / volume.spacing_m).astype(int)
        at = at[((at >= 0) & (at < limits)).all(axis=1)]
        if volume.fraction[at[:, 0], at[:, 1], at[:, 2]].any():
            return
    held = np.argwhere(volume.fraction)
    bone = [
        volume.origin_m + volume.spacing_m * corner
        for corner in (held.min(axis=0), held.max(axis=0) + 1)
    ]
    raise InputError(
        "motion",
        "bring the tool to the bone",
        "a tool that never touches it",
        f"move it to the bone {box_text((bone[0], bone[1]), between=True)}",
    )


def require_outside(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that starts with the cutting surface inside the tooth."""
    shell = cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m
    points = motion.sweep_m()[0] + shell @ motion.rotations()[0].T
    at = np.floor((points - volume.origin_m) / volume.spacing_m).astype(int)
    at = at[((at >= 0) & (at < np.array(volume.shape))).all(axis=1)]
    inside = int((volume.fraction[at[:, 0], at[:, 1], at[:, 2]] == 255).sum())
    if inside:
        start = ", ".join(f"{1e3 * value:.4g}" for value in motion.sweep_m()[0])
        raise InputError(
            "motion",
            "start outside the tooth",
            f"a bur at ({start}) mm with {inside / len(points):.0%} of its surface inside",
            "start higher",
        )


def require_whole(anatomy: Anatomy, region: Corners, *, is_image: bool) -> None:
    """Refuse bone that is cut off by the edge of its scan within the tool's reach."""
    how = "with a hole"
    remedy = "close it in a mesh editor"
    if is_image:
        how = "cut off by the edge of the image"
        remedy = "take an image that holds more of the bone"
    for points in anatomy.caps_m:
        low = points.min(axis=0)
        high = points.max(axis=0)
        if (
            (low <= region[1]).all()
            and (high >= region[0]).all()
            and not _on_one_side(points, region)
        ):
            raise InputError(
                "anatomy.file",
                "enclose a solid where the tool goes",
                f"{anatomy.name} {how} {box_text((low, high), between=True)} within the "
                "tool's reach "
                f"{box_text(region)}",
                f"{remedy}, or move the site away from it",
            )


def _on_one_side(points: NDArray[np.float64], region: Corners) -> bool:
    """Return whether a box lies completely on one side of a cap.

    The box of a cap itself is too wide where the cut is oblique.
    """
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    corners = np.array(np.meshgrid(*np.array(region).T)).reshape(3, -1).T
    cap = points @ normal
    box = corners @ normal
    return bool(box.max() < cap.min() or box.min() > cap.max())


def _guide_hole(scene: Scene, motion: Motion) -> sdf.Shape | None:
    """Return the hole that guides the peg; None without one.

    It runs along the tool's first axis, from above the face to its depth.
    """
    diameter, depth = (1e-3 * size for size in scene.bone.guide_hole_mm)
    if diameter == 0.0 or depth == 0.0:
        return None
    axis = motion.rotations()[0][:, 2]
    tip = motion.sweep_m()[0]
    on_face = tip - axis * float(tip @ axis)
    return sdf.cylinder(0.5 * diameter, tuple(on_face - depth * axis), tuple(on_face + 0.05 * axis))


def _covered(region: Corners, bone: Corners, spacing: float) -> Corners:
    """Return a box of whole bricks [m] around the bone in a region.

    It includes the air next to the bone.
    """
    brick = BRICK * spacing
    around = AROUND_VOXELS * spacing
    low = np.maximum(region[0], bone[0] - around)
    high = np.minimum(region[1], bone[1] + around)
    return brick * np.floor(low / brick + 1e-6), brick * np.ceil(high / brick - 1e-6)


def _require_memory(region: Corners, bone: Corners, spacing: float) -> None:
    """Refuse a grid that does not fit in the memory that is free now."""
    import psutil

    def needed(size: float) -> float:
        low, high = _covered(region, bone, size)
        return float(np.prod(high - low)) / size**3 * DENSE_BYTES_PER_VOXEL

    free = psutil.virtual_memory().available
    if needed(spacing) > 0.9 * free:
        fits = np.ceil(spacing * 1e5) / 1e5
        while needed(fits) > 0.8 * free:
            fits += 1e-5
        raise InputError(
            "voxels.spacing_mm",
            f"leave the bone within the free memory of {free / 1e9:.1f} GB",
            f"{spacing * 1e3:g} which needs {needed(spacing) / 1e9:.1f} GB",
            f"use {round(fits * 1e3, 2):g}",
        )
