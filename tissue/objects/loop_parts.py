"""Tissue of a tool on a device: bone made around the tool, or a touchable part of an organ."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from meshes.base.arrays import Array
from meshes.base.errors import InputError, by
from meshes.voxels.volume import VoxelVolume
from tissue.cutters import Cutter
from tissue.haptics.device.device import Device, DeviceParameters, device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TissueModel, ToolMotion
from tissue.motion.motion import frame_along
from tissue.objects.bone import Bone
from tissue.objects.organ import Organ
from tissue.objects.tools import PressingTool
from tissue.prediction.guard import GuardedMaker, Observes
from tissue.prediction.predictor import Predictor
from tissue.scene.coupling import Coupling
from tissue.scene.messages import error_of
from tissue.scene.named_parts import unknown_name
from tissue.scene.registry import RENDERERS
from tissue.scene.used_constants import used_of_device
from tissue.simulation.builders.bone import VoxelBone, tool_boxes
from tissue.simulation.builders.device import require_stated_rate
from tissue.simulation.builders.loop_settings import Contact, LoopSettings, no_predictor, sampled
from tissue.simulation.builders.own_constants import given_note
from tissue.simulation.builders.prediction import maker_of

__all__ = [
    "KeepsReady",
    "LoopOptions",
    "bone_met",
    "device_note",
    "organ_met",
    "own_names",
    "require_device",
    "require_match",
    "settings_of",
    "start_above",
    "usual_force_N",
]


KeepsReady = Callable[[Array], None]
"""Function called with the tip [m] before a tick; it makes the bone within reach."""
CLEARANCE_MM = 2.0
"""Default height of the tool above the surface at the start [mm]."""
SLOT_VOXELS, SLOT_M_S = 10, 2e-3
"""Voxels across a cutter, and its feed [m/s], for the estimate of its usual force."""
ACROSS = 7
"""Number of points across the reach at which contact with an organ is searched for."""


def bone_met(
    bone: Bone, tool: Cutter, start_m: Array, axis: Array, *, reach_m: float
) -> tuple[TissueModel, KeepsReady]:
    """Return bone under a cutter, and a function that makes more bone as the tool moves.

    At first the bone is made as far as `reach_m` around the cutter.
    """
    held = bone.voxel_bone
    made_at = start_m.copy()

    def boxes(tip_m: Array) -> tuple[Array, Array]:
        """Return the boxes around a tip."""
        spacing_m = held.store.grid.spacing_m
        return tool_boxes(tool, tip_m[None], axis[None], spacing_m=spacing_m, around_m=reach_m)

    held.reach(boxes(start_m))
    model = held.model(tool)

    def keep_ready(tip_m: Array) -> None:
        """Make more bone once half of the reach is used up; such a tick takes longer."""
        moved = tip_m - made_at
        if moved.dot(moved) > (0.5 * reach_m) ** 2:
            made_at[:] = tip_m
            if held.reach(boxes(tip_m)):
                model.record()

    return model, keep_ready


def usual_force_N(bone: Bone, tool: Cutter) -> float:
    """Compute the force of a cutter in a typical slot in the bone's first layer [N].

    The slot is a quarter of the cutter's diameter deep, at a feed of 2 mm/s.
    """
    width_m = 2.0 * tool.profile.radius_m
    spacing_m = width_m / SLOT_VOXELS
    shape = 3 * SLOT_VOXELS, 2 * SLOT_VOXELS, SLOT_VOXELS
    name = bone.layer_names[0]
    (coefficients,) = bone.voxel_bone.coefficients[:1]
    volume = VoxelVolume(
        -spacing_m * np.array([1.5 * SLOT_VOXELS, SLOT_VOXELS, SLOT_VOXELS]),
        spacing_m,
        np.full(shape, 255, dtype=np.uint8),
        np.zeros(shape, dtype=np.uint8),
        np.full(shape, round(coefficients.reference_density_kg_m3), dtype=np.uint16),
        (name,),
    )
    model = VoxelBone(volume, (coefficients,)).model(tool)
    motion = ToolMotion(speed_m_s=SLOT_M_S)
    motion.heading[0, 0] = 1.0
    motion.tip_m[:] = -0.5 * width_m, 0.0, -0.25 * width_m
    model.place(motion)
    motion.tip_m[0] = 0.0
    model.advance(motion)
    return float(np.linalg.norm(model.respond(motion).wrench[:3]))


def organ_met(
    organ: Organ, tool: PressingTool, start_m: Array, axis: Array, *, reach_m: float
) -> tuple[TissueModel, KeepsReady]:
    """Return an organ under a pressing tool, within `reach_m` around and below its start."""
    from tissue.models.organ.model import ContactSolution, LiverModel
    from tissue.models.organ.soft_organ import ToolPath

    turn = frame_along((float(axis[0]), float(axis[1]), float(axis[2])))
    across = np.linspace(-reach_m, reach_m, ACROSS)
    x, y, z = (
        each.ravel() for each in np.meshgrid(across, across, np.linspace(0.0, -reach_m, ACROSS))
    )
    tips = start_m + np.column_stack([x, y, z]) @ turn.T
    path = ToolPath(tool.shape, tips, np.broadcast_to(turn, (len(tips), 3, 3)))
    model = LiverModel(organ.soft, path, ContactSolution("condensed"))
    return model, lambda tip_m: None


def start_above(tissue: Bone | Organ, axis: Array) -> Array:
    """Return a tip above the middle of a bone or an organ, along the tool's axis [mm].

    Raises
    ------
    InputError
        If nothing lies under the middle.
    """
    surface = tissue.surface()
    low, high = np.array(surface.bounds).reshape(3, 2).T
    middle = 0.5 * (low + high)
    size = float(np.linalg.norm(high - low))
    found, _ = surface.ray_trace(middle + size * axis, middle - size * axis, first_point=True)
    if np.size(found) == 0:
        raise InputError(
            "start_mm",
            f"be given where nothing lies under the middle {by(middle, '.4g')} mm",
            "none",
            "give a place above the surface",
        )
    return np.asarray(found, dtype=np.float64).reshape(-1, 3)[0] + CLEARANCE_MM * axis


def require_device(device: object) -> None:
    """Refuse a device that cannot be read and commanded."""
    if isinstance(device, type):
        raise InputError(
            "device", "be an object", f"the class {device.__name__}", f"give {device.__name__}()"
        )
    missing = [name for name in ("read", "command") if not callable(getattr(device, name, None))]
    if missing:
        raise InputError(
            "device",
            "have read and command",
            f"{type(device).__name__} without {' and '.join(missing)}",
            "see tissue.Sample for what read gives",
        )


def require_match(tissue: object, tool: object) -> None:
    """Refuse a tool that does not match its tissue."""
    if not isinstance(tissue, Bone | Organ):
        raise InputError(
            "tissue", "be a Bone or an Organ", type(tissue).__name__, "make one of these"
        )
    if isinstance(tissue, Bone):
        tissue.require_cutter(tool)
    elif not isinstance(tool, PressingTool):
        raise InputError("tool", "press an organ", type(tool).__name__, "make one by tissue.ball")


@dataclass(frozen=True)
class LoopOptions:
    """Arguments of a loop for the part between device and tool; see `tissue.objects.loop.Loop`."""

    limits: str | DeviceParameters | Mapping[str, float]
    hand: str
    materials: Materials
    renderer: str
    contact: Contact
    low_pass_ms: float
    predictor: str | Observes | None
    predictor_file: str | Path | None
    coupling: Mapping[str, float | None]


def settings_of(device: Device, options: LoopOptions) -> LoopSettings:
    """Return the settings between a device and a tool, from a caller's arguments."""
    limits = options.limits
    predictor = options.predictor
    numbers = device_parameters(limits, options.materials) if isinstance(limits, str) else limits
    if isinstance(numbers, Mapping):
        known = [each.name for each in fields(DeviceParameters)]
        if unknown := [name for name in numbers if name not in known]:
            raise unknown_name("limits", known, unknown[0])
        try:
            numbers = DeviceParameters(**numbers)
        except TypeError:
            raise InputError(
                "limits", "give mass_kg and damping_N_s_m", "neither or one", "add both"
            ) from None
    if not isinstance(numbers, DeviceParameters):
        raise InputError(
            "limits",
            "be a device's name, tissue.DeviceParameters or a mapping of its numbers",
            type(limits).__name__,
            "give one of these",
        )
    numbers = sampled(numbers)
    require_stated_rate(device, numbers, remedy="give this rate_Hz by limits")
    if isinstance(predictor, type):
        name = predictor.__name__
        raise InputError("predictor", "be an object", f"the class {name}", f"give {name}()")
    if options.predictor_file is not None and not isinstance(predictor, str):
        raise InputError(
            "predictor_file",
            "come with a predictor's name",
            f"{predictor!r}",
            "name one, or drop it",
        )
    RENDERERS[options.renderer]  # refuse an unknown renderer under the argument's name

    limit_N = numbers.force_limit_N
    made: Callable[[], Predictor | None] = no_predictor
    if isinstance(predictor, str):
        made = maker_of(
            predictor, scene_name="", file=str(options.predictor_file or ""), force_limit_N=limit_N
        )
    elif predictor is not None:
        guarded = GuardedMaker(type(predictor).__name__, lambda: deepcopy(predictor))
        made = lambda: guarded(None, limit_N)  # noqa: E731

    given = {name: value for name, value in options.coupling.items() if value is not None}
    try:
        chosen = Coupling.model_validate(given)
    except ValidationError as error:
        raise error_of(error.errors()[0], given, Coupling) from None
    return LoopSettings(
        type(device).__name__,
        numbers,
        options.hand,
        hand_parameters(options.hand, options.materials),
        chosen,
        options.renderer,
        options.low_pass_ms,
        options.contact,
        predictor=made,
    )


def device_note(
    given: Materials, tissue: Bone | Organ, *, limits: object, hand: str
) -> dict[str, str]:
    """Return a note on the constants of a named device and of the hand that come from a file.

    Raises
    ------
    InputError
        If the file has none of these constants.
    """
    layers = tissue.layer_names if isinstance(tissue, Bone) else ()
    used = used_of_device(given, limits if isinstance(limits, str) else None, hand)
    found = given_note(given, used, layers=layers, by="loop")
    return {f"{name} of device and hand": note for name, note in found.items()}


@contextmanager
def own_names() -> Iterator[None]:
    """Make refusals name arguments instead of a scene's keys or the command's options."""
    try:
        yield
    except InputError as error:
        words = (
            str(error)
            .replace("coupling.", "")
            .replace("output.", "")
            .replace("--allow-unstable", "allow_unstable")
        )
        raise InputError(words) from error
