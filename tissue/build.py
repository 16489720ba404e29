"""Turn a scene's names into parts: the registry of anatomies, tools and motions."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import radians, pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes import sdf
from meshes.anatomy import Anatomy, cortical_block
from meshes.errors import InputError
from meshes.glenoid import glenoid
from meshes.volume import VoxelVolume
from meshes.voxelise import voxelise
from tissue import cutters
from tissue.cutters import Cutter
from tissue.model import TissueModel
from tissue.motion import FollowPath, Motion, PushAlongAxis, read_poses
from tissue.scene import AnatomyFile, BlockAnatomy, GlenoidAnatomy, PathMotion, ReplayMotion, Scene, ThrustMotion, Tool

__all__ = ["Parts", "build", "cutter_of", "motion_of", "reach", "volume_of"]

Tell = Callable[[str, float], None]
SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
POSES_TRIED = 300
"""Poses along a motion at which contact is looked for."""
DENSE_BYTES_PER_VOXEL = 16
"""Peak memory of a voxel of the region while bricks are made and results written, measured on the glenoid."""


@dataclass
class Parts:
    """What a run is made of."""

    motion: Motion
    cutter: Cutter
    volume: VoxelVolume
    tissue: TissueModel
    notes: dict[str, str] = field(default_factory=dict)


def build(scene: Scene, *, step_s: float, compute: str, cores: int | None, tell: Tell) -> Parts:
    """Build the parts of a scene.

    Raises
    ------
    InputError
        If a file cannot be used, the voxels would not fit memory, the tool never touches, or there is no such device.
    """
    cutter, motion = cutter_of(scene.tool), motion_of(scene, step_s=step_s)
    notes: dict[str, str] = {}
    tell("building the anatomy", 0.0)
    volume = volume_of(scene, cutter, motion, notes=notes, tell=tell)
    _require_touch(volume, cutter, motion)
    return Parts(motion, cutter, volume, _bone(scene, volume, cutter, compute=compute, cores=cores, tell=tell), notes)


def cutter_of(tool: Tool) -> Cutter:
    """The cutter that a scene's tool describes."""
    d, peg = tool.diameter_mm * 1e-3, (tool.peg_diameter_mm * 1e-3, tool.peg_length_mm * 1e-3)
    match tool.kind:
        case "ball-burr":
            profile = cutters.ball_burr(diameter_m=d)
        case "cylinder":
            profile = cutters.cylinder(diameter_m=d, length_m=tool.length_mm * 1e-3)
        case "twist-drill":
            angle = radians(tool.point_angle_deg)
            profile = cutters.twist_drill(diameter_m=d, length_m=tool.length_mm * 1e-3, point_angle_rad=angle)
        case "hemispherical-reamer":
            profile = cutters.hemispherical_reamer(diameter_m=d, peg_diameter_m=peg[0], peg_length_m=peg[1])
        case "flat-reamer":
            thickness = tool.length_mm * 1e-3
            profile = cutters.flat_reamer(
                diameter_m=d, thickness_m=thickness, peg_diameter_m=peg[0], peg_length_m=peg[1]
            )
    return Cutter(profile, tool.flutes, tool.spin_rpm * 2.0 * pi / 60.0)


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """The motion that a scene describes."""
    match scene.motion:
        case PathMotion() as path:
            return FollowPath(np.array(path.points_mm) * 1e-3, feed_m_s=path.feed_mm_s * 1e-3, axis=path.axis)
        case ThrustMotion() as push:
            return PushAlongAxis(
                np.array(push.start_mm) * 1e-3,
                axis=push.axis,
                thrust_N=push.thrust_N,
                mass_kg=push.mass_kg,
                max_feed_m_s=push.max_feed_mm_s * 1e-3,
                depth_m=push.depth_mm * 1e-3,
            )
        case ReplayMotion() as replay:
            return read_poses(Path(replay.file), step_s=step_s)


def volume_of(scene: Scene, cutter: Cutter, motion: Motion, *, notes: dict[str, str], tell: Tell) -> VoxelVolume:
    """Voxels of the bone that the tool can reach, with the guide hole drilled."""
    spacing = scene.voxels.spacing_mm * 1e-3
    parameters = scene.anatomy
    region = reach(cutter, motion, scene.voxels.margin_mm * 1e-3)
    if _is_image(parameters) and isinstance(parameters, BlockAnatomy) and parameters.centre_mm is None:
        with _named(parameters):
            return _image(scene, notes=notes)
    with _named(parameters):
        anatomy = _anatomy(scene, notes)
    bone = np.array(anatomy.shape.lower_m), np.array(anatomy.shape.upper_m)
    low = np.maximum(region[0], bone[0])
    high = np.minimum(region[1], bone[1])
    if (low >= high).any():
        raise InputError(
            f"motion must bring the tool to the bone, got one that reaches from {_mm(region[0])} to {_mm(region[1])} mm "
            f"with the tool and a margin: move it to the bone between {_mm(bone[0])} and {_mm(bone[1])} mm"
        )
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
    parameters = scene.anatomy
    if parameters.file is not None:
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
    elif isinstance(parameters, GlenoidAnatomy):
        anatomy = glenoid(
            width_mm=parameters.width_mm,
            height_mm=parameters.height_mm,
            curvature_radius_mm=parameters.curvature_radius_mm,
            subchondral_thickness_mm=parameters.subchondral_thickness_mm,
        )
    else:
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
        if argument == "resample_mm":
            said = "voxels.spacing_mm" + said.removeprefix(argument)
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

    parameters = scene.anatomy
    said: list[str] = []
    volume = read_volume(
        parameters.file or "",
        threshold=_threshold(parameters),
        spacing_mm=parameters.spacing_mm,
        density_kg_m3=parameters.density_kg_m3 if isinstance(parameters, BlockAnatomy) else 1800.0,
        resample_mm=scene.voxels.spacing_mm,
        tell=said.append,
    )
    notes["image"] = " ".join(said) or f"{parameters.file}: {volume.shape} voxels"
    return volume


def _bone(
    scene: Scene, volume: VoxelVolume, cutter: Cutter, *, compute: str, cores: int | None, tell: Tell
) -> TissueModel:
    """The bone model; loading it compiles its kernels where their cache is cold."""
    import warp as wp

    if compute != "cpu" and compute not in [str(device) for device in wp.get_devices()]:
        raise InputError(
            f"compute must be one of {', '.join(str(d) for d in wp.get_devices())}, got {compute}: use cpu here"
        )
    tell("compiling kernels (the first time on a machine)", 0.0)
    from tissue.bone import BoneModel
    from tissue.materials import cutting_coefficients

    changes = scene.cutting.model_dump()
    spacing_mm = scene.tool.shell_spacing_mm
    return BoneModel(
        volume,
        cutter,
        tuple(cutting_coefficients("bone", **changes) for _ in volume.layer_names),
        removal=scene.voxels.removal,
        shell_spacing_m=None if spacing_mm is None else spacing_mm * 1e-3,
        device=compute,
        cores=cores,
    )


def _guide_hole(scene: Scene, motion: Motion) -> sdf.Shape | None:
    """The hole that guides the peg: along the tool's first axis, from above the face to its depth."""
    diameter, depth = scene.anatomy.guide_hole_diameter_mm * 1e-3, scene.anatomy.guide_hole_depth_mm * 1e-3
    if diameter == 0.0 or depth == 0.0:
        return None
    axis, tip = motion.rotations()[0][:, 2], motion.sweep_m()[0]
    on_face = tip - axis * float(tip @ axis)
    return sdf.cylinder(0.5 * diameter, tuple(on_face - depth * axis), tuple(on_face + 0.05 * axis))


def reach(cutter: Cutter, motion: Motion, margin: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Box around all that the cutting surface can reach, and a margin [m]."""
    shell = cutter.shell(spacing_m=cutter.profile.radius_m / 8.0).points_m
    tips, rotations = motion.sweep_m(), motion.rotations()
    starts = np.arange(0, len(tips), max(len(tips) // 500, 1))
    turned = [shell @ turn.T for turn in rotations[starts]]
    low = np.minimum.reduceat(tips, starts) + [points.min(axis=0) for points in turned]
    high = np.maximum.reduceat(tips, starts) + [points.max(axis=0) for points in turned]
    return low.min(axis=0) - margin, high.max(axis=0) + margin


def _require_touch(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that never brings the cutting surface into bone."""
    shell = cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m
    corners, rotations = motion.sweep_m(), motion.rotations()
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    wanted = np.unique(np.concatenate([np.linspace(0.0, along[-1], POSES_TRIED), along[:: len(along) // POSES_TRIED + 1]]))
    tips = np.column_stack([np.interp(wanted, along, corners[:, c]) for c in range(3)])
    turns = rotations[np.searchsorted(along, wanted)]
    limits = np.array(volume.shape)
    for tip, turn in zip(tips[::-1], turns[::-1], strict=True):
        at = np.floor((tip + shell @ turn.T - volume.origin_m) / volume.spacing_m).astype(int)
        at = at[((at >= 0) & (at < limits)).all(axis=1)]
        if volume.fraction[at[:, 0], at[:, 1], at[:, 2]].any():
            return
    low, high = volume.bounds_m
    raise InputError(
        "motion must bring the tool to the bone, got a tool that never touches it: move it to the bone between "
        f"{_mm(low)} and {_mm(high)} mm"
    )


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


def _mm(point: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{1e3 * value:.4g}" for value in point) + ")"
