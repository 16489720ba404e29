"""Objects that simulate a scene, checks of the tool's motion, and opening of real devices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array, Bytes, Ints
from meshes.base.errors import InputError, in_brackets, is_file, names_of_caller
from meshes.base.placement import Placement
from meshes.paths.toolpath import arc_length, points_along
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.fem.fields import FieldSeries
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import SafeDevice
from tissue.models.bone.region_end import RegionEnd
from tissue.models.keep_clear import KeepClear
from tissue.models.tissue_model import TICK_S, HasFields, TissueModel
from tissue.motion.drilling_recording import RECORDINGS, SHAFT_TO_X
from tissue.motion.motion import Events, FollowPath, Motion
from tissue.motion.quaternion import Triple
from tissue.motion.replay import read_replay
from tissue.motion.thrust import PushAlongAxis
from tissue.scene.coupling import Hardware
from tissue.scene.registry import DEVICES, MOTIONS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion

FILE_WORDS = ("file", "surface", "vertices", "faces", "triangles", "cells", "nodes", "labels")
"""Argument names of the functions that read anatomy files and tool files."""
RECORDED = "recorded"
"""Name of the device that replays a motion from a file."""
Corners = tuple[Array, Array]
"""Lowest and highest corner of a box [m]."""
POSES_TRIED = 300
"""Number of poses along a motion at which contact is searched for; chosen.

With more poses, the preparation of a run takes longer. With fewer poses, contact between two poses
may be missed.
"""
FAR_M = 0.1
"""Distance between path and bone [m] above which a run contains a note.

A robot may approach the bone from this distance. For a simulated bone that is larger than this
value, the size of the bone is used instead. The value was chosen by judgement.
"""
MUCH_MORE = 2.0
"""Ratio above which a run suggests another order of the quaternions in a recorded motion.

The share of the tool's surface inside the bone at the start is computed for the orders (x, y, z, w)
and (w, x, y, z). The ratio is the first share divided by the second share. The value was chosen by
judgement.
"""


@dataclass
class Parts:
    """Objects that simulate a scene in a run.

    Attributes
    ----------
    motion, tissue
        Motion of the tool, and model of the tissue.
    cutter, volume
        Cutter, and voxels before the first cut; both None if the tool does not cut.
    placement
        Pose of the scene in the frame of the file from which the anatomy was read; None for an
        anatomy without a file.
    notes
        Notes on assumptions and findings, keyed by subject.
    events
        Events that are reported at the start of the run, each with a time [s] and a sentence.
    keep_clear
        Measurement of the tool's distance from structures that it must not touch; None if the scene
        names no structure.
    region_end
        Object that reports when the tool leaves the simulated region; None for a scripted motion.
    """

    motion: Motion
    tissue: TissueModel
    cutter: Cutter | None = None
    volume: VoxelVolume | None = None
    placement: Placement | None = None
    notes: dict[str, str] = field(default_factory=dict)
    keep_clear: KeepClear | None = None
    region_end: RegionEnd | None = None
    events: Events = field(default_factory=list)

    @property
    def fields(self) -> FieldSeries | None:
        """Fields over time, such as displacement; None if the tissue or the scene has no fields."""
        return self.tissue.fields if isinstance(self.tissue, HasFields) else None


TissueBuilder = Callable[..., Parts]
"""Function that builds the objects of a run from a scene with one kind of anatomy.

It is called as ``build(scene, motion, *, step_s, compute, cores, report)``. The arguments are the
motion of the tool, the duration of a tick [s], the Warp device, the number of processor cores, and
a function that reports progress.
"""


def plays_record(scene: Scene) -> bool:
    """Return True if the device of a scene replays recorded poses from a file that exists.

    A saved run can be viewed without this file. The motion in the scene is then used.
    """
    return (
        scene.device is not None
        and scene.device.kind == RECORDED
        and is_file(Path(scene.held.hardware.address))
    )


def recorded_file(scene: Scene) -> str:
    """Return the path of the file with recorded tool poses; empty if the motion is not recorded.

    The file is given for a replay motion or for a recorded device.
    """
    if plays_record(scene):
        return scene.held.hardware.address
    return scene.motion.file if isinstance(scene.motion, ReplayMotion) else ""


def require_no_pause(scene: Scene) -> None:
    """Raise an error if two consecutive points of a path are equal.

    `FollowPath` would ignore such a point, and the tool would not pause there. Folders of earlier
    runs may have such a path, so the scene is checked before a run and not when it is read.
    """
    if not isinstance(scene.motion, PathMotion):
        return
    points = scene.motion.points_mm
    for number, (point, following) in enumerate(pairwise(points), start=1):
        # A path without any other point has an error of its own.
        if point == following and len(set(points)) > 1:
            raise InputError(
                "motion.points_mm",
                "not repeat a point",
                f"{in_brackets(point, 'g')} as points {number} and {number + 1}",
                "remove one of them. A pause of the tool needs a recorded motion with times: "
                "motion.kind = replay",
            )


def motion_of(scene: Scene) -> Motion:
    """Return the motion of a scene; with a recorded device, return the recorded motion.

    With a recorded device, the tool starts at the first recorded pose, and the tissue is prepared
    along the recorded motion.
    """
    if plays_record(scene):
        with names_of_caller({"motion.file": "hardware.address"}):
            return read_replay(Path(scene.held.hardware.address))
    motion = scene.motion
    make: Callable[[Any, float], Motion] | None = MOTIONS[motion.kind].make
    if make is not None:
        return make(motion, TICK_S)
    if isinstance(motion, PathMotion):
        return FollowPath(
            1e-3 * np.array(motion.points_mm), feed_m_s=1e-3 * motion.feed_mm_s, axis=motion.axis
        )
    if isinstance(motion, ThrustMotion):
        return PushAlongAxis(
            1e-3 * np.array(motion.start_mm),
            axis=motion.axis,
            thrust_N=motion.thrust_N,
            mass_kg=motion.mass_kg,
            max_feed_m_s=1e-3 * motion.max_feed_mm_s,
            depth_m=1e-3 * motion.depth_mm,
        )
    return read_replay(Path(motion.file))


def reach(cutter: Cutter, motion: Motion, margin: float) -> Corners:
    """Return a box around all positions of the cutting surface, with a margin [m]."""
    return swept_box(cutter.coarse_shell_m(), motion, margin)


def reach_of_tool(
    cutter: Cutter, motion: Motion, margin: float, *, guide_hole: Shape | None
) -> Corners:
    """Return a box around all positions of the tool that can touch bone, with a margin [m].

    Parts of the non-cutting surface that never leave the guide hole, such as a peg, touch no bone.
    """
    points = cutter.coarse_surface_m()
    if guide_hole is not None and cutter.has_smooth_surface:
        every = slice(None, None, len(motion.sweep_m()) // POSES_TRIED + 1)
        # The points of the smooth surface are the last ones.
        stays = np.arange(len(points)) >= len(cutter.coarse_shell_m())
        for tip, turn in zip(*poses_along(motion, every, POSES_TRIED), strict=True):
            stays[stays] = guide_hole.distance(tip + points[stays] @ turn.T) < 0.0
        points = points[~stays]
    return swept_box(points, motion, margin)


def swept_box(shell: Array, motion: Motion, margin: float) -> Corners:
    """Return a box, with a margin [m], around all positions of points of the tool.

    The points `shell` have shape (n, 3), in the frame of the tool [m].
    """
    tips = motion.sweep_m()
    rotations = motion.rotations()
    # A recorded motion has an orientation in every tick. It is divided into about 500 parts, and
    # the first orientation of a part is used for the whole part.
    starts = np.arange(0, len(tips), max(len(tips) // 500, 1))
    turned = [shell @ turn.T for turn in rotations[starts]]
    low = np.minimum.reduceat(tips, starts) + [points.min(axis=0) for points in turned]
    high = np.maximum.reduceat(tips, starts) + [points.max(axis=0) for points in turned]
    return low.min(axis=0) - margin, high.max(axis=0) + margin


def poses_along(motion: Motion, chosen: slice | Ints, count: int) -> tuple[Array, Array]:
    """Return poses along a motion at which the program checks for contact.

    The result is tips, shape (p, 3), in metres, and rotations, shape (p, 3, 3). The poses are
    `count` poses at equal distances, and the motion's corners with the indices `chosen`.
    """
    corners = motion.sweep_m()
    turns = motion.rotations()
    along = arc_length(corners)
    wanted = np.unique(np.concatenate([np.linspace(0.0, along[-1], count), along[chosen]]))
    at = np.searchsorted(along, wanted).clip(max=len(turns) - 1)
    return points_along(corners, wanted), turns[at]


def box_text(corners: Corners) -> str:
    """Return a text with the corners of a box [mm]."""
    low, high = (in_brackets(1e3 * corner, ".4g") for corner in corners)
    return f"between {low} and {high} mm"


def _fraction_at(volume: VoxelVolume, points_m: Array) -> Bytes:
    """Return the content of the voxels that contain points [m]; omit points outside the volume."""
    at = np.floor((points_m - volume.origin_m) / volume.spacing_m).astype(int)
    at = at[((at >= 0) & (at < np.array(volume.shape))).all(axis=1)]
    return volume.fraction[at[:, 0], at[:, 1], at[:, 2]]


def _fine_shell(volume: VoxelVolume, cutter: Cutter) -> Array:
    """Return closely spaced points of the cutting surface [m], shape (n, 3).

    The distance between points is one voxel, but at least 1/24 of the radius of the cutter.
    """
    # A distance below the size of a voxel finds no more contact. 24 points per radius limit the
    # work.
    return cutter.shell(spacing_m=max(cutter.profile.radius_m / 24.0, volume.spacing_m)).points_m


def require_touch(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Raise an error if a motion never brings the cutting surface into bone."""
    shell = _fine_shell(volume, cutter)
    every = slice(None, None, len(motion.sweep_m()) // POSES_TRIED + 1)
    tips, turns = poses_along(motion, every, POSES_TRIED)
    # Motions end in the bone, so a search from the end finds contact soon.
    for tip, turn in zip(tips[::-1], turns[::-1], strict=True):
        if _fraction_at(volume, tip + shell @ turn.T).any():
            return
    raise InputError(
        "motion",
        "bring the tool to the bone",
        "a tool that never touches it",
        f"move the tool to the bone, which lies {box_text(volume.bone_bounds_m)}",
    )


def far_note(volume: VoxelVolume, points_mm: Sequence[Sequence[float]]) -> str | None:
    """Return a note on the corner of a path with the largest distance from the bone, or None.

    The result is None if all corners are near the simulated bone, see `FAR_M`.
    """
    low, high = volume.bone_bounds_m
    points = 1e-3 * np.array(points_mm)
    away = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    farthest = int(away.argmax())
    if away[farthest] <= max(FAR_M, float((high - low).max())):
        return None
    return (
        f"motion.points_mm leads to {in_brackets(points_mm[farthest], '.4g')} mm. This is "
        f"{1e3 * away[farthest]:.3g} mm away from the simulated tissue, which lies "
        f"{box_text((low, high))}. Check that the points are in mm"
    )


def require_outside(volume: VoxelVolume, cutter: Cutter, motion: Motion) -> None:
    """Raise an error if a motion starts with the cutting surface inside the tooth."""
    tip = motion.sweep_m()[0]
    inside = _share_inside(volume, cutter, tip, motion.rotations()[0])
    if inside > 0.0:
        raise InputError(
            "motion",
            "start outside the tooth",
            f"a bur at {in_brackets(1e3 * tip, '.4g')} mm with {inside:.0%} of its surface inside",
            "start higher",
        )


def _share_inside(volume: VoxelVolume, cutter: Cutter, tip_m: Array, rotation: Array) -> float:
    """Return the share of the cutting surface that lies in full voxels at a pose."""
    shell = _fine_shell(volume, cutter)
    held = _fraction_at(volume, tip_m + shell @ rotation.T)
    return float(np.count_nonzero(held == FULL) / len(shell))


def require_whole(anatomy: Anatomy, region: Corners, *, is_image: bool) -> None:
    """Raise an error if the tool reaches a place where the edge of a scan cuts off the bone."""
    how = "with a hole"
    remedy = "close the hole in a mesh editor"
    if is_image:
        how = "cut off by the edge of the image"
        remedy = "use an image that contains more of the bone"
    for points in anatomy.caps_m:
        low = points.min(axis=0)
        high = points.max(axis=0)
        is_near = (low <= region[1]).all() and (high >= region[0]).all()
        if is_near and not _on_one_side(points, region):
            raise InputError(
                "anatomy.file",
                "enclose a solid where the tool moves",
                f"{anatomy.name} {how} {box_text((low, high))}, and a tool that moves "
                f"{box_text(region)}",
                f"{remedy}, or move the site away from this place",
            )


def _on_one_side(points: Array, region: Corners) -> bool:
    """Return True if a region (box) lies completely on one side of a cap.

    A cap is a plane where a scan cuts off bone; `points` are points of this plane. A test with the
    bounding box of the cap would be too coarse for an oblique cap.
    """
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    corners = np.array(np.meshgrid(*np.array(region).T)).reshape(3, -1).T
    cap = points @ normal
    box = corners @ normal
    return bool(box.max() < cap.min() or box.min() > cap.max())


def w_first_notice(volume: VoxelVolume, cutter: Cutter, motion: Motion, file: str) -> str | None:
    """Return a sentence if the start pose suggests that quaternions are in the order w, x, y, z.

    The result is None otherwise. The sentence is returned if the tool starts inside the bone, but
    the overlap is much smaller with w as the first column, see `MUCH_MORE`. A quaternion has unit
    length in both orders, so the order can only be recognised from the position of the tool.

    Parameters
    ----------
    volume, cutter, motion
        Bone, tool and recorded motion.
    file
        File of the recorded poses. The kind of file determines which axis of the recorded frame is
        the axis of the tool.
    """
    turn = SHAFT_TO_X if Path(file).suffix.lower() in RECORDINGS else Rotation.identity()
    rotation = Rotation.from_matrix(motion.rotations()[0])
    first, second, third, fourth = (rotation * turn.inv()).as_quat()
    other = Rotation.from_quat([second, third, fourth, first]) * turn
    inside, by_other = (
        _share_inside(volume, cutter, motion.sweep_m()[0], each.as_matrix())
        for each in (rotation, other)
    )
    if inside <= MUCH_MORE * by_other:
        return None
    return (
        f"the tool starts with {inside:.0%} of its surface inside the bone. With its quaternions "
        f"read as (w, x, y, z) it would be {by_other:.0%}: their order is (x, y, z, w), so swap "
        f"the columns of {file} if w comes first"
    )


def opens_device(scene: Scene) -> bool:
    """Return True if the device of a scene is a real device."""
    return scene.device is not None and DEVICES[scene.held.kind].is_real


def opened_device(scene: Scene) -> Device | None:
    """Open the real device of a scene, built in or registered with `tissue.register.device`.

    The result is None for a simulated device.

    Raises
    ------
    InputError
        If the device object has no `read` or `command` method.
    """
    if not opens_device(scene):
        return None
    x, y, z = motion_of(scene).sweep_m()[0].tolist()
    return new_device(scene.held.kind, scene.held.hardware, start_m=(x, y, z))


def new_device(kind: str, hardware: Hardware, *, start_m: Triple) -> Device | None:
    """Return a new real device whose first pose is mapped to ``start_m``.

    The result is None for a kind of device that is only simulated.

    Raises
    ------
    InputError
        If the device object has no `read` or `command` method.
    """
    entry = DEVICES[kind]
    if entry.has_adapter:
        from tissue.haptics.real.adapter import adapter_class
        from tissue.haptics.real.mapped import MappedDevice

        return MappedDevice(adapter_class(kind)(hardware), hardware, start_m=start_m)
    if entry.make is None:
        return None
    device: Device = entry.make(start_m)
    require_device(device, kind)
    return device


def require_device(device: object, kind: str = "") -> None:
    """Raise an error if a device is a class, or lacks the method `read` or `command`.

    The error names the device by `kind`, its name in a scene.
    """
    if isinstance(device, type):
        name = device.__name__
        raise InputError("device", "be an object", f"the class {name}", f"give {name}()")
    missing = [name for name in ("read", "command") if not callable(getattr(device, name, None))]
    if missing:
        known = f" for {kind}" if kind else ""
        raise InputError(
            "device",
            "have the methods read and command",
            f"{type(device).__name__} without {' and '.join(missing)}{known}",
            "add the missing methods; read returns a tissue.Sample",
        )


def require_stated_rate(
    device: Device | SafeDevice, limits: DeviceParameters, *, remedy: str
) -> None:
    """Raise an error if a device is slower than assumed in the stability check.

    The device may give its rate [samples per second] in its attribute ``limits`` or ``parameters``.
    Without these attributes, the device is assumed to have the rate in the argument `limits`.

    Raises
    ------
    InputError
        If the rate of the device is lower than the rate in the argument `limits`.
    """
    held = device.device if isinstance(device, SafeDevice) else device
    for name in ("limits", "parameters"):
        stated = getattr(held, name, None)
        # 1e-6 allows for rounding. A device that is faster than the ticks is fast enough.
        if isinstance(stated, DeviceParameters) and stated.rate_Hz < min(
            limits.rate_Hz, 1.0 / TICK_S
        ) * (1.0 - 1e-6):
            raise InputError(
                "device",
                f"have the sample rate that its constants state, {limits.rate_Hz:g} Hz",
                f"{stated.rate_Hz:g} Hz from {type(held).__name__}",
                remedy,
            )
