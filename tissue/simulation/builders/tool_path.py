"""Path of a tool through tissue: its reach, checks of it, and its distance from structures."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kernels.tool_distance import TOLERANCE_M
from meshes.base.arrays import Array, Bytes, Ints
from meshes.base.errors import InputError, in_brackets
from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.paths.toolpath import arc_length, points_along
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape, shape_triangles
from meshes.voxels.mesh_sampling import triangle_distance
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.body import body_points
from tissue.cutters.cutter import Cutter
from tissue.models.keep_clear import Distance, KeepClear, Structure
from tissue.motion.motion import Motion
from tissue.motion.replay import RECORDINGS, SHAFT_TO_X
from tissue.scene.scene import KeepClear as Wanted
from tissue.simulation.builders.arguments import surface_of

__all__ = [
    "Corners",
    "box_text",
    "keep_clear",
    "poses_along",
    "reach",
    "require_outside",
    "require_touch",
    "require_whole",
    "w_first_notice",
]

Corners = tuple[Array, Array]
"""Lowest and highest corner of a box [m]."""
POSES_TRIED = 300
"""Number of poses along a motion at which contact is searched for; chosen."""
MUCH_MORE = 2.0
"""Ratio of the volumes inside the bone above which the other quaternion order is suggested.

Assumed: a tool that starts in contact lies in some bone with either order.
"""
MARGIN_M = 10e-3
"""Margin beyond the scripted motion, since a hand may leave it [m]; assumed."""
POINTS_ACROSS = 12.0
"""Number of points of the tool's surface over its radius, for pictures; chosen."""


def reach(cutter: Cutter, motion: Motion, margin: float) -> Corners:
    """Return a box around everything that the cutting surface can reach, with a margin [m]."""
    # Eighths of the radius miss at most 0.09 mm of the reach in the built-in scenes, far less than
    # the margin of the voxels.
    return _swept(cutter.shell(spacing_m=cutter.profile.radius_m / 8.0).points_m, motion, margin)


def _swept(shell: Array, motion: Motion, margin: float) -> Corners:
    """Return a box around the reach of the tool's points, shape (n, 3), with a margin [m]."""
    tips = motion.sweep_m()
    rotations = motion.rotations()
    # The orientation of every 500th part stands for its part: a recorded motion has one in every
    # tick.
    starts = np.arange(0, len(tips), max(len(tips) // 500, 1))
    turned = [shell @ turn.T for turn in rotations[starts]]
    low = np.minimum.reduceat(tips, starts) + [points.min(axis=0) for points in turned]
    high = np.maximum.reduceat(tips, starts) + [points.max(axis=0) for points in turned]
    return low.min(axis=0) - margin, high.max(axis=0) + margin


def poses_along(motion: Motion, chosen: slice | Ints, count: int) -> tuple[Array, Array]:
    """Return poses along a motion at which contact is searched for.

    They are tips [m], shape (p, 3), and turns, shape (p, 3, 3): `count` poses with equal distances
    and the chosen corners of the motion.
    """
    corners = motion.sweep_m()
    turns = motion.rotations()
    along = arc_length(corners)
    wanted = np.unique(np.concatenate([np.linspace(0.0, along[-1], count), along[chosen]]))
    at = np.searchsorted(along, wanted).clip(max=len(turns) - 1)
    return points_along(corners, wanted), turns[at]


def box_text(corners: Corners) -> str:
    """Return text for the corners of a box [mm]."""
    low, high = (in_brackets(1e3 * corner, ".4g") for corner in corners)
    return f"between {low} and {high} mm"


def _fraction_at(volume: VoxelVolume, points_m: Array) -> Bytes:
    """Return the filling of the voxels around points [m]; points outside are left out."""
    at = np.floor((points_m - volume.origin_m) / volume.spacing_m).astype(int)
    at = at[((at >= 0) & (at < np.array(volume.shape))).all(axis=1)]
    return volume.fraction[at[:, 0], at[:, 1], at[:, 2]]


def _fine_shell(volume: VoxelVolume, cutter: Cutter) -> Array:
    """Return points of the cutting surface that miss no voxel [m], shape (n, 3)."""
    # Finer than a voxel finds nothing more. 24 points over the radius bound the work.
    return cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m


def require_touch(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that never brings the cutting surface into bone."""
    shell = _fine_shell(volume, cutter)
    every = slice(None, None, len(motion.sweep_m()) // POSES_TRIED + 1)
    tips, turns = poses_along(motion, every, POSES_TRIED)
    # Motions end in the bone: from the end, contact is found soon.
    for tip, turn in zip(tips[::-1], turns[::-1], strict=True):
        if _fraction_at(volume, tip + shell @ turn.T).any():
            return
    held = np.argwhere(volume.fraction)
    low, high = (
        volume.origin_m + volume.spacing_m * corner
        for corner in (held.min(axis=0), held.max(axis=0) + 1)
    )
    raise InputError(
        "motion",
        "bring the tool to the bone",
        "a tool that never touches it",
        f"move it to the bone {box_text((low, high))}",
    )


def require_outside(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Refuse a motion that starts with the cutting surface inside the tooth."""
    shell = _fine_shell(volume, cutter)
    points = motion.sweep_m()[0] + shell @ motion.rotations()[0].T
    inside = int((_fraction_at(volume, points) == FULL).sum())
    if inside:
        start = in_brackets(1e3 * motion.sweep_m()[0], ".4g")
        raise InputError(
            "motion",
            "start outside the tooth",
            f"a bur at {start} mm with {inside / len(points):.0%} of its surface inside",
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
        is_near = (low <= region[1]).all() and (high >= region[0]).all()
        if is_near and not _on_one_side(points, region):
            raise InputError(
                "anatomy.file",
                "enclose a solid where the tool goes",
                f"{anatomy.name} {how} {box_text((low, high))}, for a tool that reaches "
                f"{box_text(region)}",
                f"{remedy}, or move the site away from it",
            )


def _on_one_side(points: Array, region: Corners) -> bool:
    """Return whether a box lies completely on one side of a cap.

    The box of a cap itself is too wide where the cut is oblique.
    """
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    corners = np.array(np.meshgrid(*np.array(region).T)).reshape(3, -1).T
    cap = points @ normal
    box = corners @ normal
    return bool(box.max() < cap.min() or box.min() > cap.max())


def w_first_notice(volume: VoxelVolume, cutter: Cutter, motion: Motion, file: str) -> str | None:
    """Return a sentence if the start pose suggests that w is the first column; else None.

    The tool then starts inside the bone, and would hardly do so with the other order. A quaternion
    has unit length in either order, so only the position of the tool shows the order.

    Parameters
    ----------
    volume, cutter, motion
        The bone, the tool, and the recorded motion.
    file
        File of the recorded poses, whose kind gives the axis of the recorded tool.
    """
    turn = SHAFT_TO_X if Path(file).suffix.lower() in RECORDINGS else Rotation.identity()
    rotation = Rotation.from_matrix(motion.rotations()[0])
    first, second, third, fourth = (rotation * turn.inv()).as_quat()
    other = Rotation.from_quat([second, third, fourth, first]) * turn
    inside, by_other = (
        _inside_mm3(volume, cutter, motion.sweep_m()[0], each) for each in (rotation, other)
    )
    if inside <= MUCH_MORE * by_other:
        return None
    return (
        f"the tool starts with {inside:.3g} mm3 inside the bone. With its quaternions read as "
        f"(w, x, y, z) it would be {by_other:.3g} mm3: their order is (x, y, z, w), so swap the "
        f"columns of {file} if w comes first"
    )


def _inside_mm3(volume: VoxelVolume, cutter: Cutter, tip_m: Array, rotation: Rotation) -> float:
    """Return the bone inside the cutter at a pose [mm3], by the centres of the voxels."""
    spacing_m = volume.spacing_m
    far_m = np.hypot(cutter.profile.radius_m, np.abs(cutter.profile.height_range_m).max())
    middle = (tip_m - volume.origin_m) / spacing_m
    first = np.clip(np.floor(middle - far_m / spacing_m).astype(int), 0, volume.shape)
    last = np.clip(np.ceil(middle + far_m / spacing_m).astype(int), 0, volume.shape)
    held = volume.fraction[tuple(slice(start, end) for start, end in zip(first, last, strict=True))]
    filled = np.argwhere(held)
    if not len(filled):
        return 0.0
    centres_m = volume.origin_m + spacing_m * (first + filled + 0.5)
    x, y, z = rotation.inv().apply(centres_m - tip_m).T
    distance_m, _ = cutter.profile.distance(np.column_stack([np.hypot(x, y), z]))
    shares = held[tuple(filled.T)] / FULL
    return float(1e9 * spacing_m**3 * shares[distance_m < 0.0].sum())


def keep_clear(
    wanted: Wanted,
    shapes: Mapping[str, Shape],
    cutter: Cutter,
    motion: Motion,
    *,
    placement: Placement | None,
    notes: dict[str, str],
    report: Progress,
) -> KeepClear:
    """Build the measurement of a cutter's distance from the structures that a scene names.

    Parameters
    ----------
    shapes
        Structures that the anatomy knows, in the frame of the scene, by name.
    placement
        Pose of the scene in the frame of the anatomy's file; None where both frames are the same.

    Raises
    ------
    InputError
        If the anatomy has no such structure, or a file cannot be used.
    """
    points = body_points(cutter.profile, spacing_m=cutter.profile.radius_m / POINTS_ACROSS)
    low, high = _swept(points, motion, MARGIN_M)
    distances: dict[str, Distance] = {}
    found: dict[str, Structure] = {}
    for name in wanted.names:
        if name not in shapes:
            raise InputError(
                "keep_clear.names",
                f"be structures of the anatomy ({', '.join(shapes) or 'none'})",
                name,
                "give its surface in [keep_clear.files]",
            )
        report(f"meshing the surface of {name}", 0.0)
        distances[name] = shapes[name].distance
        found[name] = Structure(*shape_triangles(shapes[name], low, high))
    for name, file in wanted.files.items():
        report(f"reading the surface of {name}", 0.0)
        unit = 1.0 if placement is None else placement.unit_mm
        surface = surface_of(f"keep_clear.files.{name}", Path(file), unit, is_part=True)
        vertices: Array = surface.vertices_m
        if placement is not None:
            vertices = 1e-3 * placement.to_scene(1e3 * vertices / unit)
        found[name] = Structure(vertices, surface.faces)
        distances[name] = partial(triangle_distance, vertices, surface.faces)
        if surface.report.repairs:
            notes[f"surface of {name}"] = " ".join(surface.report.repairs)
    for name, structure in found.items():
        below_mm = 1e3 * (structure.slack_m + float(TOLERANCE_M))
        notes[f"keep clear of {name}"] = (
            f"its distance is in the trace, exact or up to {below_mm:.2g} mm too small"
        )
    return KeepClear(cutter.profile, found, distances, points_m=points, box_m=np.array([low, high]))
