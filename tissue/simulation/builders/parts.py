"""Parts of a run, and builders that all kinds of scenes share: motions, devices, constants."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.base.placement import Placement
from meshes.surfaces.glenoid import GLENOID_LAYERS
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.triangle_files import read_triangles
from meshes.tets.files import require_millimetres
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.vertebra.lumbar import VERTEBRA_LAYERS
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.fem.fields import FieldSeries
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import SafeDevice
from tissue.materials.constants import listed
from tissue.materials.scene_constants import Materials
from tissue.models.keep_clear import KeepClear
from tissue.models.tissue_model import TICK_S, HasFields, TissueModel
from tissue.motion.motion import FollowPath, Motion
from tissue.motion.replay import read_replay
from tissue.motion.thrust import PushAlongAxis
from tissue.scene.messages import sentence
from tissue.scene.named_parts import nearest, shown
from tissue.scene.part import Part
from tissue.scene.registry import DEVICES, MOTIONS
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion
from tissue.scene.used_constants import Used, used_constants

__all__ = [
    "FILE_WORDS",
    "Parts",
    "TissueBuilder",
    "given_note",
    "motion_of",
    "note_own_constants",
    "opened_device",
    "opens_device",
    "plays_record",
    "recorded_file",
    "require_device",
    "require_known",
    "require_stated_rate",
    "soft_constants",
    "stated",
    "surface_of",
]

Table = TypeVar("Table", bound=Part)
FILE_WORDS = ("file", "surface", "vertices", "faces", "triangles", "cells", "nodes", "labels")
"""Argument names of the functions that read files of anatomy or tools."""
RECORDED = "recorded"
"""Device that plays a motion recorded in a file."""
LAYERS = (*GLENOID_LAYERS, *VERTEBRA_LAYERS, *TOOTH_LAYERS)
"""Layers of the built-in anatomies.

A file may hold constants of a layer that a scene does not have.
"""


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
        from tissue.haptics.real.mapped import MappedDevice
        from tissue.haptics.real.search import adapter_class

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
        if isinstance(stated, DeviceParameters) and stated.rate_Hz < min(
            limits.rate_Hz, 1.0 / TICK_S
        ) * (1.0 - 1e-6):
            raise InputError(
                "device",
                f"give the {limits.rate_Hz:g} samples a second of its constants",
                f"{stated.rate_Hz:g} by {type(held).__name__}",
                remedy,
            )


def note_own_constants(scene: Scene, layers: Sequence[str], notes: dict[str, str]) -> None:
    """Note which constants of its file a scene uses, and which it does not use.

    Raises
    ------
    InputError
        If no constant has an effect, the scene itself states one of them, or a layer is unknown.
    """
    notes |= given_note(scene.constants, used_constants(scene, layers), layers=layers, by="scene")


def require_known(options: Mapping[str, object], table: type, *, of: str) -> None:
    """Refuse an option that a table of options lacks, as Python does for a listed signature."""
    known = table.__annotations__
    for name in options:
        if name not in known:
            raise TypeError(
                f"{of} got an unexpected keyword argument {name!r}{nearest(name, known)}. Beyond "
                f"its listed arguments it takes {', '.join(sorted(known))}."
            )


def stated(model: type[Table], values: Mapping[str, object], *, prefix: str = "") -> Table:
    """Return a scene's table of a caller's arguments; None counts as not stated.

    The prefix precedes the name of a value that cannot be used.

    Raises
    ------
    InputError
        If a value is out of its range, or there is no such key.
    """
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return model.model_validate(given)
    except ValidationError as error:
        raise InputError(prefix + sentence(error.errors()[0], given, model)) from None


def given_note(
    given: Materials, rests_on: Sequence[Used], *, layers: Sequence[str], by: str
) -> dict[str, str]:
    """Return the note ``materials`` on the given constants that `by` uses.

    The note is empty where all constants are cited.

    Raises
    ------
    InputError
        As for `note_own_constants`.
    """
    if not given.given:
        return {}
    name = Path(given.file).name
    known = dict.fromkeys((*listed("cutting"), *LAYERS, *layers))
    for entry in given.given:
        table, layer, _ = entry.split(".")
        if table == "cutting" and layer not in known:
            raise InputError(
                "materials",
                "name a material of cutting or a layer",
                f"{layer}{nearest(layer, known)} in {name}",
                f"use one of {', '.join(known)}",
            )
    used = {one.full: one for one in rests_on if one.full in given.given}
    for full, one in used.items():
        if one.stated is not None:
            part = (
                "organ.young_kPa"
                if one.name == "modulus_kPa"
                else f"{full.split('.')[0]}.{one.name}"
            )
            part = part.replace("soft.", "organ.")
            raise InputError(
                part,
                f"be left out where materials states {full}",
                shown(one.stated),
                "remove one of them",
            )
    if not used:
        raise InputError(
            "materials",
            f"hold a constant that the {by} rests on",
            f"{', '.join(given.given)} in {name}",
            f"name the materials of this {by}, or leave materials out",
        )
    note = f"of {name}: " + "; ".join(
        f"{full} {one.cited.value:g} ({one.cited.low:g}-{one.cited.high:g}), {one.cited.source}"
        for full, one in used.items()
    )
    if unused := [full for full in given.given if full not in used]:
        note += f". Not used in this {by}: {', '.join(unused)}"
    return {"materials": note}


def soft_constants(
    materials: str | PathLike[str] | Materials | None,
    material: str,
    stated: Mapping[str, float | None],
) -> tuple[dict[str, float], dict[str, str]]:
    """Return constants of an organ's material by name, and the note on their file.

    The names are the keys of `stated`; a stated value takes precedence.

    Raises
    ------
    InputError
        As for `note_own_constants`.
    """
    given = Materials.of(materials)
    known = given.constants("soft", material)
    used = [
        Used(f"soft, {material}", name, known[name], f"soft.{material}.{name}", value)
        for name, value in stated.items()
    ]
    taken = {name: known[name].value if value is None else value for name, value in stated.items()}
    return taken, given_note(given, used, layers=(), by="organ")


def surface_of(
    name: str, given: object, scale_mm: float | None, *, is_part: bool = False
) -> Surface:
    """Return a closed surface from a file, a pyvista or trimesh surface, or vertices and triangles.

    With `is_part` all its pieces are kept, and it may end at the edge of a scan.

    Raises
    ------
    InputError
        If it is no surface, its size points to another unit, or it encloses no solid.
    """
    source = name
    if isinstance(given, str | Path):
        source = Path(given).name
        with names_of_caller({"file": name}):
            vertices, faces = read_triangles(Path(given))
    else:
        vertices, faces = _triangles(name, given)
    scale = require_millimetres(name, vertices, scale_mm)
    with names_of_caller(dict.fromkeys(("surface", "vertices", "faces", "triangles"), name)):
        return surface_from_triangles(
            vertices,
            faces,
            source=source,
            scale_mm=scale,
            cut_off=is_part,
            every_piece=is_part,
        )


def _triangles(name: str, given: Any) -> tuple[Array, Ints]:
    """Return vertices and triangles of a surface in memory."""
    if hasattr(given, "is_all_triangles"):  # pyvista
        whole = given.triangulate()
        return np.asarray(whole.points, dtype=np.float64), np.asarray(
            whole.regular_faces, dtype=np.int64
        )
    if hasattr(given, "vertices") and hasattr(given, "faces"):  # trimesh
        given = given.vertices, given.faces
    if isinstance(given, Sequence) and len(given) == 2:
        vertices, faces = (np.asarray(each) for each in given)
        if vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3:
            return vertices.astype(np.float64), faces.astype(np.int64)
    raise InputError(
        name,
        "be a closed surface of pyvista or trimesh, vertices and triangles, or a file",
        type(given).__name__,
        "export it as STL",
    )
