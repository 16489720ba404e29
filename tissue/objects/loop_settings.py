"""Validation and defaults of the arguments of `tissue.Loop`."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TypedDict

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import (
    InputError,
    in_brackets,
    names_of_caller,
    require_positive,
    require_range,
)
from tissue.cutters import Cutter, ball_burr
from tissue.haptics.device.device import Device, DeviceParameters, device_parameters
from tissue.haptics.hand_motion import HandMotion, Script
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import StaysAt, frame_along
from tissue.objects.bone import Bone, constants_of
from tissue.objects.cutting import Structures
from tissue.objects.organ import Organ
from tissue.objects.part_checks import checked_numbers
from tissue.objects.tools import PressingTool, ball
from tissue.prediction.guard import GuardedMaker, Observes, copy_of
from tissue.scene.coupling import Coupling
from tissue.scene.coupling import Device as StatedDevice
from tissue.scene.load import load_scene
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Output, Scene
from tissue.scene.used_constants import used_of_device
from tissue.simulation.builders.arguments import given_note, stated
from tissue.simulation.builders.force_scale import ExpectedForce, Series, scale_for, slot_force_N
from tissue.simulation.builders.hand import device_motion
from tissue.simulation.builders.loop import LoopSettings, sampled
from tissue.simulation.builders.parts import require_device, require_stated_rate
from tissue.simulation.posed import Region

ARGUMENTS = {
    **{f"coupling.{key}": key for key in Coupling.model_fields},
    "output.low_pass_ms": "low_pass_ms",
    "prediction": "predictor",
    "kind": "limits",
}
"""Arguments of `Loop` that replace scene keys in error messages, keyed by scene key."""
CLEARANCE_MM = 2.0
"""Default height of the tool above the surface at the start [mm]."""
LONGEST_S = 3600.0
"""Largest accepted value of `longest_s`, the time for which rows of the trace are allocated [s].

One hour of a trace with 60 columns takes 1.7 GB.
"""
REACH_MM = 5.0
SCENE_REACH_MM = 2.0
"""Default distance from a scene's path within which tissue is prepared [mm]."""
MOST_TICKS = 1000
"""Largest number of ticks in a step. A step of 1000 ticks takes 1 s."""


class LoopOptions(TypedDict, total=False):
    """Options of the coupling between device and tool; see `Loop`."""

    limits: str | DeviceParameters | Mapping[str, float]
    predictor: str | Observes | None
    predictor_file: str | Path | None
    hand: str
    materials: str | PathLike[str] | Materials | None
    renderer: str
    stiffness_N_m: float | None
    force_scale: float | None
    motion_scale: float
    delay_ms: int
    low_pass_ms: float
    allow_unstable: bool


@dataclass(frozen=True)
class JudgedDevice:
    """Motion and output settings of a device whose coupling has passed the stability check.

    Attributes
    ----------
    motion
        Motion of the tool.
    output
        Options for the force that is sent to the device.
    notes
        Notes on constants and on the coupling, keyed by subject.
    """

    motion: HandMotion
    output: Output
    notes: dict[str, str]


def judged_device(
    device: Device,
    tissue: Bone | Organ,
    tool: Cutter | PressingTool,
    start_m: Array,
    along: Array,
    options: LoopOptions,
) -> JudgedDevice:
    """Check the stability of the coupling between a device and a tool.

    Parameters
    ----------
    device
        Device. Its origin corresponds to the start position of the tip.
    tissue, tool
        Tissue, and the tool that cuts or presses it.
    start_m, along
        Start position of the tip [m], and direction from the tool's tip to its shank, each of shape
        (3,).
    options
        Options from the caller of `Loop`.

    Raises
    ------
    InputError
        If an option cannot be used, or the coupling is unstable and `allow_unstable` is not set.
    """
    require_device(device)
    constants = Materials.of(options.get("materials"))
    with names_of_caller(ARGUMENTS):
        settings = _settings_of(device, options, constants, cuts=isinstance(tissue, Bone))
    scale = options.get("force_scale")
    scale_note = ""
    if isinstance(tissue, Bone) and scale is None:
        assert isinstance(tool, Cutter)
        usual_N = slot_force_N(tissue.voxel_bone, tool)
        series = Series.of(settings.limits, settings.constants)
        scale = scale_for(ExpectedForce(usual_N), settings.limits, series)
        scale_note = (
            f", chosen for the {usual_N:.3g} N of a slot a quarter of the cutter deep at 2 mm/s"
        )
    script = Script(
        motion=StaysAt(start_m, along),
        motion_scale=settings.coupling.motion_scale,
        device_origin_m=start_m,
    )
    with names_of_caller(ARGUMENTS):
        motion, found = device_motion(
            settings,
            script,
            lambda held, stiffness: device,
            force_scale=(
                require_positive(
                    "force_scale", 1.0 if scale is None else scale, "use a value such as 1"
                ),
                scale_note,
            ),
            # Only a perception draws random numbers, and this loop has no perception.
            rng=np.random.default_rng(0),
            allow_unstable=options.get("allow_unstable", False),
        )
    limits = options.get("limits", "touch")
    used = used_of_device(
        constants, limits if isinstance(limits, str) else None, options.get("hand", "expert")
    )
    layers = tissue.layer_names if isinstance(tissue, Bone) else ()
    given = given_note(constants, used, layers=layers, by="loop")
    notes = {f"{name} of device and hand": note for name, note in given.items()}
    notes["coupling"] = "; ".join(found)
    return JudgedDevice(motion, settings.output, notes)


def _settings_of(
    device: Device, options: LoopOptions, constants: Materials, *, cuts: bool
) -> LoopSettings:
    """Return the settings of the coupling between device and tool, from the options of `Loop`."""
    given = options.get("limits", "touch")
    limits = sampled(_limits(given, constants))
    require_stated_rate(device, limits, remedy="give this rate_Hz in limits")
    predictor = options.get("predictor")
    file = options.get("predictor_file")
    name = predictor if isinstance(predictor, str) else None
    own_predictor = None
    if isinstance(predictor, type):
        kind = predictor.__name__
        raise InputError("predictor", "be an object", f"the class {kind}", f"give {kind}()")
    if file is not None and name is None:
        raise InputError(
            "predictor_file",
            "be given only if predictor is a name",
            f"predictor={predictor!r}",
            "set predictor to a name, or remove predictor_file",
        )
    if predictor is not None and name is None:
        own = type(predictor).__name__
        guarded = GuardedMaker(own, lambda: copy_of(predictor, own))
        own_predictor = partial(guarded, None, limits.force_limit_N)
    coupling = {key: options.get(key) for key in ("stiffness_N_m", "motion_scale", "delay_ms")}
    is_trained = name is not None and name in PREDICTORS and PREDICTORS[name].trained
    if is_trained:
        if file is None:
            raise InputError(
                "predictor_file",
                f"be given for the predictor {name}",
                "nothing",
                "give the file that `tissue train SCENE --out FILE` wrote",
            )
        coupling["predictor_file"] = str(file)
    held = {
        # The caller gave parameters without a name, so the name is not used.
        "kind": given if isinstance(given, str) else "touch",
        "hand": options.get("hand"),
        "renderer": options.get("renderer"),
        "prediction": name,
        "coupling": stated(Coupling, coupling),
    }
    return LoopSettings(
        stated(StatedDevice, held),
        stated(Output, {"low_pass_ms": options.get("low_pass_ms")}),
        type(device).__name__,
        limits,
        constants,
        "cuts" if cuts else "presses",
        own_predictor=own_predictor,
    )


def _limits(
    given: str | DeviceParameters | Mapping[str, float], constants: Materials
) -> DeviceParameters:
    """Return the parameters of a device from its name, from a mapping, or as given."""
    if isinstance(given, str):
        return device_parameters(given, constants)
    needed = ("mass_kg", "damping_N_s_m")
    return DeviceParameters(**checked_numbers(DeviceParameters, given, needed=needed, of="limits"))


def tissue_of(tissue: Bone | Organ | Scene | str) -> Bone | Organ | Scene:
    """Return a tissue or a scene unchanged; for a name, load the scene of this name.

    Raises
    ------
    InputError
        If the argument is of another type, or no scene has the name.
    """
    found = load_scene(tissue) if isinstance(tissue, str) else tissue
    if not isinstance(found, Bone | Organ | Scene):
        raise InputError(
            "tissue",
            "be a Bone, an Organ, a scene or its name",
            f"an object of type {type(found).__name__}",
            "give one of these",
        )
    return found


def extent(
    *, is_scene: bool, longest_s: float, step_ms: int, reach_mm: float | None
) -> tuple[int, int, float]:
    """Compute two numbers of ticks and the reach of the tissue model from arguments of `Loop`.

    The result has three values: the number of ticks that the trace keeps, the number of ticks in a
    step, and a distance [m]. The model is built for tissue within this distance of the tool, or of
    the path in a scene.

    Raises
    ------
    InputError
        If an argument is out of range.
    """
    longest = require_range("longest_s", longest_s, TICK_S, LONGEST_S, "use a value such as 600")
    ticks = require_range("step_ms", step_ms, 1, MOST_TICKS, "use a value such as 1")
    if ticks != round(ticks):
        raise InputError(
            "step_ms", "be a whole number of ticks of 1 ms", step_ms, "use a value such as 1"
        )
    usual_mm = SCENE_REACH_MM if is_scene else REACH_MM
    least_mm = 0.0 if is_scene else 0.5
    reach = usual_mm if reach_mm is None else reach_mm
    checked_mm = require_range(
        "reach_mm", reach, least_mm, 100.0, f"use a value such as {usual_mm:g}"
    )
    return round(longest / TICK_S), round(ticks), 1e-3 * checked_mm


def checked_tool(
    tissue: Bone | Organ, tool: Cutter | PressingTool | None, keep_clear: Structures | None
) -> Cutter | PressingTool:
    """Validate the tool and return it, or return the default tool for the tissue."""
    if isinstance(tissue, Bone):
        burr = tool or ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
        tissue.require_cutter(burr)
        return burr
    if keep_clear:
        raise InputError(
            "keep_clear",
            "be left out for an organ",
            "structures",
            "remove it, because only a bone accepts it",
        )
    pressing = tool or ball(diameter_mm=10)
    if not isinstance(pressing, PressingTool):
        raise InputError(
            "tool",
            "be a tool that presses an organ",
            f"an object of type {type(tool).__name__}",
            "make a tool with tissue.ball. A needle or a blade works only in a scene, "
            "such as tissue.Loop('needle')",
        )
    return pressing


def made_from_of(
    tissue: Bone | Organ, tool: Cutter | PressingTool, keep_clear: Structures | None
) -> tuple[object, ...]:
    """Return the data that determine the forces and must match when a snapshot is restored."""
    if isinstance(tissue, Bone):
        return (*constants_of(tissue), tool, tuple(keep_clear or ()))
    assert isinstance(tool, PressingTool)
    organ = tissue.soft
    return (
        organ.mesh,
        organ.space.order,
        organ.elasticity,
        organ.held,
        organ.prony,
        organ.friction,
        organ.law,
        organ.capsule,
        organ.rest[0],
        tool.shape,
    )


def region(start_m: Array, axis: Array, reach_m: float) -> Region:
    """Return the region, around and below a start position, in which a tool may touch an organ."""
    turn = frame_along(axis)
    place = start_m @ turn
    far = np.array([reach_m, reach_m, np.inf])
    return Region(turn, place - reach_m, place + far)


def start_above(tissue: Bone | Organ, tool: Cutter | PressingTool, axis: Array) -> Array:
    """Return the default start position of a tip above the middle of a bone or an organ [mm].

    For an organ, the start is moved along `axis` until the tool does not touch the organ.
    """
    surface = tissue.surface()
    low, high = np.array(surface.bounds).reshape(3, 2).T
    middle = 0.5 * (low + high)
    size = float(np.linalg.norm(high - low))
    found, _ = surface.ray_trace(middle + size * axis, middle - size * axis)
    if np.size(found) == 0:
        raise InputError(
            "start_mm",
            "be given, because the line along axis through the middle "
            f"{in_brackets(middle, '.4g')} mm does not meet the surface",
            "none",
            "give a point above the surface",
        )
    # pyvista does not sort the points along the ray.
    points = np.asarray(found, dtype=np.float64).reshape(-1, 3)
    start = points[np.argmax(points @ axis)] + CLEARANCE_MM * axis
    if isinstance(tissue, Organ) and isinstance(tool, PressingTool):
        from tissue.models.organ.press import surface_points_m

        nodes = 1e3 * surface_points_m(tissue.soft, tool.shape)
        turn = frame_along(axis)
        while tool.shape.distance(1e-3 * (nodes - start) @ turn).min() <= 0.0:
            start = start + CLEARANCE_MM * axis
    return start
