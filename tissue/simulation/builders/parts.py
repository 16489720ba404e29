"""Parts of a run, and the motions and real devices that scenes of all kinds share."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.base.placement import Placement
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.fem.fields import FieldSeries
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import SafeDevice
from tissue.models.keep_clear import KeepClear
from tissue.models.tissue_model import TICK_S, HasFields, TissueModel
from tissue.motion.motion import FollowPath, Motion
from tissue.motion.replay import read_replay
from tissue.motion.thrust import PushAlongAxis
from tissue.scene.registry import DEVICES, MOTIONS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion

__all__ = [
    "FILE_WORDS",
    "Parts",
    "TissueBuilder",
    "motion_of",
    "opened_device",
    "opens_device",
    "plays_record",
    "recorded_file",
    "require_device",
    "require_stated_rate",
]

FILE_WORDS = ("file", "surface", "vertices", "faces", "triangles", "cells", "nodes", "labels")
"""Argument names of the functions that read files of anatomy or tools."""
RECORDED = "recorded"
"""Device that plays a motion recorded in a file."""


@dataclass
class Parts:
    """Parts of a run.

    Attributes
    ----------
    motion, tissue
        Motion of the tool, and the tissue that it meets.
    cutter, volume
        The cutter and the voxels that it cuts; None where the tool does not cut.
    placement
        Pose of the scene's frame in the frame of the anatomy's file; None without a file.
    notes
        Notes on assumptions and findings, by subject.
    events
        Events reported from the start of the run: time [s] and a sentence each.
    keep_clear
        Measures the tool's distance from structures that it must not touch; None where the scene
        names no structure.
    """

    motion: Motion
    tissue: TissueModel
    cutter: Cutter | None = None
    volume: VoxelVolume | None = None
    placement: Placement | None = None
    notes: dict[str, str] = field(default_factory=dict)
    keep_clear: KeepClear | None = None
    events: list[tuple[float, str]] = field(default_factory=list)

    @property
    def fields(self) -> FieldSeries | None:
        """Displacement and stress over time; None where the tissue or the scene has none."""
        return self.tissue.fields if isinstance(self.tissue, HasFields) else None


TissueBuilder = Callable[..., Parts]
"""Function that makes the parts of a run from a scene with one kind of anatomy.

It is called as ``build(scene, motion, *, step_s, compute, cores, report)``: with the motion of the
tool, the length of a tick [s], the device that computes, processor cores, and progress."""


def plays_record(scene: Scene) -> bool:
    """Return whether a device plays recorded poses from a file that exists.

    A saved run can be viewed without the file; its scene then has the motion of the scene.
    """
    return (
        scene.device is not None
        and scene.device.kind == RECORDED
        and is_file(Path(scene.held.hardware.address))
    )


def recorded_file(scene: Scene) -> str:
    """Return the file of the poses that move the tool; empty for other motions.

    The file comes from a replay or a recorded device.
    """
    if plays_record(scene):
        return scene.held.hardware.address
    return scene.motion.file if isinstance(scene.motion, ReplayMotion) else ""


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """Return the motion of a scene, or of the record with a recorded device.

    The tool then starts where it was recorded, and the tissue is prepared along the record.
    """
    if plays_record(scene):
        with names_of_caller({"motion.file": "hardware.address"}):
            return read_replay(Path(scene.held.hardware.address), step_s=step_s)
    motion = scene.motion
    make: Callable[[Any, float], Motion] | None = MOTIONS[motion.kind].make
    if make is not None:
        return make(motion, step_s)
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
    return read_replay(Path(motion.file), step_s=step_s)


def opens_device(scene: Scene) -> bool:
    """Return whether a scene names a real device that can be opened."""
    return scene.device is not None and DEVICES[scene.held.kind].is_real


def opened_device(scene: Scene) -> Device | None:
    """Open a new device, by its adapter or as registered with `tissue.register.device`.

    Returns None for a simulated device.

    Raises
    ------
    InputError
        If the object made has no `read` or `command` method.
    """
    if not opens_device(scene):
        return None
    entry = DEVICES[scene.held.kind]
    x, y, z = motion_of(scene, step_s=TICK_S).sweep_m()[0].tolist()
    if entry.has_adapter:
        from tissue.haptics.real.adapter import adapter_class
        from tissue.haptics.real.mapped import MappedDevice

        hardware = scene.held.hardware
        return MappedDevice(adapter_class(scene.held.kind)(hardware), hardware, start_m=(x, y, z))
    assert entry.make is not None
    device: Device = entry.make((x, y, z))
    require_device(device, scene.held.kind)
    return device


def require_device(device: object, kind: str = "") -> None:
    """Refuse a device that cannot be read and commanded; `kind` is its name in a scene."""
    missing = [name for name in ("read", "command") if not callable(getattr(device, name, None))]
    if missing:
        known = f" for {kind}" if kind else ""
        raise InputError(
            "device",
            "have read and command",
            f"{type(device).__name__} without {' and '.join(missing)}{known}",
            "see tissue.Sample for what read gives",
        )


def require_stated_rate(
    device: Device | SafeDevice, limits: DeviceParameters, *, remedy: str
) -> None:
    """Refuse a device slower than the constants used to judge its loop.

    A device states its rate [samples per second] in ``limits`` or ``parameters``. A device without
    either is assumed to have the constants' rate.

    Raises
    ------
    InputError
        If the device is slower than its constants.
    """
    held = device.device if isinstance(device, SafeDevice) else device
    for name in ("limits", "parameters"):
        stated = getattr(held, name, None)
        # 1e-6: rounding. A device faster than the ticks is fast enough.
        if isinstance(stated, DeviceParameters) and stated.rate_Hz < min(
            limits.rate_Hz, 1.0 / TICK_S
        ) * (1.0 - 1e-6):
            raise InputError(
                "device",
                f"give the {limits.rate_Hz:g} samples a second of its constants",
                f"{stated.rate_Hz:g} by {type(held).__name__}",
                remedy,
            )
