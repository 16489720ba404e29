"""Build the motion of a tool that is coupled to a haptic device, in a real or simulated hand."""

from collections.abc import Callable
from dataclasses import replace
from math import ceil, inf

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.paths.toolpath import arc_length
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, Path, waypoints
from tissue.haptics.hand.pushing import CompensatedPath, Thrust
from tissue.haptics.hand_motion import HandMotion, Rendering, Script
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.vibration import Cues, PlayedForce, PlayedVibration
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import HeldTool, HeldTurn, PressingTool
from tissue.haptics.proxy.probing_tool import ProbingTool
from tissue.haptics.renderer import Renderer, TurningRenderer, renderer
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import Motion, quaternion_of
from tissue.perception.perceived import Perception
from tissue.scene.coupling import WallAnatomy
from tissue.scene.registry import DEVICES
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion, ThrustMotion, Tool
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.builders.loop import (
    LoopSettings,
    judged_loops,
    lead_ticks,
    loop_settings,
    person_of,
    release_note,
)
from tissue.simulation.builders.parts import plays_record

STRAY_M = 2e-3
"""Distance around the scripted path within which an organ is prepared for a hand [m].

A hand trembles and misses its targets. The value is assumed.
"""
TOOLS: dict[str, type[HeldTool]] = {"cuts": CuttingTool, "touches": ProbingTool}
"""Models of a tool that a spring couples to a device, keyed by the kind of contact.

All other tools are a `PressingTool`.
"""


def hand_motion(scene: Scene, scripted: Motion, *, allow_unstable: bool) -> tuple[HandMotion, str]:
    """Return the motion of a tool that a simulated hand moves through a device, and a note.

    The note describes the device, the hand, the renderer, and the chosen stiffness and force scale.

    Raises
    ------
    InputError
        If the coupling is unstable and `allow_unstable` is not set, or the motion leaves the
        workspace of the device.
    """
    settings = loop_settings(scene)
    person = settings.person
    scale = settings.coupling.motion_scale
    if not plays_record(scene):
        _require_workspace(scene, scripted, settings.limits)
    start = scripted.sweep_m()[0]
    rng, feeling = np.random.default_rng(scene.seed).spawn(2)

    def device(tool: HeldTool, stiffness_N_m: float) -> SimulatedDevice:
        """Return the device in the simulated hand, which makes the scripted motion."""
        path, push = _aims(scene, scripted, tool, settings, stiffness_N_m)
        turn = _turn(scripted) if isinstance(scene.motion, ReplayMotion) else None
        at_device: Path = lambda time_s: start + (path(time_s) - start) / scale  # noqa: E731
        hand = Hand(person, at_device, rng=rng, step_s=settings.sample_s, push=push, turn=turn)
        x, y, z = start.tolist()
        return SimulatedDevice(settings.limits, hand, position_m=(x, y, z))

    stray_m = STRAY_M
    if settings.coupling.roam_mm is not None:
        stray_m = 1e-3 * settings.coupling.roam_mm
    # Voxels have a margin of their own, and a wall needs no preparation.
    elif isinstance(scene.tool, Tool) or isinstance(scene.anatomy, WallAnatomy):
        stray_m = 0.0
    script = Script(
        motion=scripted,
        motion_scale=scale,
        stray_m=stray_m,
        after_s=person.reaction_s + person.submovement_s + person.correction_s,
    )
    force_scale = chosen_scale(scene)
    motion, notes = device_motion(
        settings,
        script,
        device,
        force_scale=force_scale[:2],
        rng=feeling,
        allow_unstable=allow_unstable,
    )
    limit_N = settings.limits.force_limit_N
    if isinstance(scene.motion, ThrustMotion) and limit_N < force_scale[0] * scene.motion.thrust_N:
        notes.append(
            f"the hand presses with {limit_N / force_scale[0]:.3g} of motion.thrust_N = "
            f"{scene.motion.thrust_N:g}, because the device has at most {limit_N:g} N; lower "
            "coupling.force_scale"
        )
    held = settings.held
    # a run with a real device uses the simulated hand only for the stability check
    holds = "checked for" if DEVICES[held.kind].is_real else "in"
    note = (
        f"{held.kind} {holds} the hand of {person_of(held.hand)}, renderer {held.renderer}: "
        f"{'; '.join(notes)}"
    )
    return motion, note


def _require_workspace(scene: Scene, scripted: Motion, limits: DeviceParameters) -> None:
    """Raise an error if a motion leaves the workspace of the device.

    The device may be turned, so any side of the workspace box may lie along any axis of the motion.
    """
    workspace = limits.workspace_m
    extent = np.sort(np.ptp(scripted.sweep_m(), axis=0))
    scale = scene.held.coupling.motion_scale
    if (extent > scale * workspace).any():
        # The scale is rounded up to two decimals. 1e-9 prevents that an exact value is rounded up.
        fits = ceil(100.0 * float((extent / workspace).max()) - 1e-9) / 100.0
        sizes = lambda edges: " x ".join(f"{1e3 * each:.0f}" for each in edges[::-1])  # noqa: E731
        raise InputError(
            "coupling.motion_scale",
            (
                f"be at least {fits:g} for a motion of {sizes(extent)} mm in the workspace of "
                f"{scene.held.kind}, {sizes(workspace)} mm"
            ),
            f"{scale:g}",
            f"use {fits:g}",
        )


def _aims(
    scene: Scene,
    scripted: Motion,
    tool: HeldTool,
    settings: LoopSettings,
    stiffness_N_m: float,
) -> tuple[Path, Callable[[float], Array] | None]:
    """Return the path of the hand's target position, and the function of an additional hand force.

    The function is None if the hand only follows the path.
    """
    corners = scripted.sweep_m()
    limits = settings.limits
    person = settings.person
    scale = settings.coupling.motion_scale
    furthest = scale * limits.force_limit_N * (1.0 / stiffness_N_m + 1.0 / person.stiffness_N_m)
    if isinstance(scene.motion, ThrustMotion):
        push_N = min(chosen_scale(scene)[0] * scene.motion.thrust_N, limits.force_limit_N)
        thrust = Thrust(
            corners[0], corners[-1] - corners[0], tool, push_N, scale * push_N / stiffness_N_m
        )
        return thrust.path, thrust.push
    path = waypoints(*_timed(scripted, recorded=isinstance(scene.motion, ReplayMotion)))
    if isinstance(scene.anatomy, WallAnatomy) or isinstance(tool, ProbingTool):
        return path, None  # no force moves a tool into a wall or a bone
    return CompensatedPath(
        path, tool, person.submovement_s - 0.5 * person.correction_s, furthest
    ), None


def _turn(scripted: Motion) -> Callable[[float], Array]:
    """Return a function from time [s] to the rotation of a recorded motion since its start.

    The returned function gives a unit quaternion (x, y, z, w).
    """
    turns = scripted.rotations()
    quaternions = np.array([quaternion_of(turn @ turns[0].T) for turn in turns])
    return lambda time_s: quaternions[min(round(time_s / TICK_S), len(quaternions) - 1)]


def _timed(scripted: Motion, *, recorded: bool) -> tuple[Array, Array]:
    """Return the times [s] and points [m] of a motion.

    A recorded motion has one point per tick. The times of a path follow from its feed.
    """
    corners_m = scripted.sweep_m()
    if recorded:
        return TICK_S * np.arange(len(corners_m), dtype=np.float64), corners_m
    along = arc_length(corners_m)
    # Repeated corners have equal times, which an interpolation cannot use.
    keep = np.diff(along, prepend=-1.0) > 0.0
    times = along * (scripted.duration_s / along[-1])
    return times[keep], corners_m[keep]


def device_motion(
    settings: LoopSettings,
    script: Script,
    device: Callable[[HeldTool, float], Device],
    *,
    force_scale: tuple[float, str],
    rng: np.random.Generator,
    allow_unstable: bool,
) -> tuple[HandMotion, list[str]]:
    """Return the motion of a tool that is coupled to a device, and notes on the chosen settings.

    The device force is f times the force on the tool, and the tool moves m times as far as the
    device. A stiffness K at the tool is therefore felt as m f K. Torques are scaled by f / m, so
    that the work at the device is f / m times the work at the tool. The stiffness of the coupling
    is given at the device, so it does not depend on f and m. The stability check uses the same
    value.

    Parameters
    ----------
    settings, script
        Settings of the loop between device and tool, and the motion that the hand follows.
    device
        Function that makes the device. Its arguments are the tool that is coupled to the device,
        and the stiffness of the coupling [N/m].
    force_scale
        Newtons at the device for each newton at the tool, and a note on how the scale was chosen.
    rng
        Random generator of the sensory noise in the perceptual scaling of the force.
    allow_unstable
        Whether an unstable coupling is accepted.

    Raises
    ------
    InputError
        If the coupling is unstable and `allow_unstable` is not set.
    """
    chosen = settings.coupling
    scale = chosen.motion_scale
    judged, turning = judged_loops(settings, allow_unstable=allow_unstable)
    # The energy balance needs the delay from a sample to the force that answers it. It does not
    # include the delay of a balance of the tool that is found a tick later.
    delay_s = settings.limits.transport_delay_s + 1e-3 * chosen.delay_ms
    loop = replace(judged.loop, delay_s=delay_s)
    factor, how = force_scale
    spring = judged.loop.stiffness_N_m / (scale * factor)
    turn = HeldTurn(turning.loop.stiffness_N_m * scale / factor if turning else inf)
    kind = TOOLS.get(settings.contact, PressingTool)
    tool = kind(spring, script.motion.sweep_m()[0], turn)
    felt = settings.perception(rng)
    rendering = Rendering(
        law=_law(settings, loop),
        loop=loop,
        margin=judged.verdict.margin,
        turning_law=TurningRenderer(_law(settings, turning.loop)) if turning else None,
        delay_ticks=chosen.delay_ms,
        model_ticks=chosen.model_ms,
        predictor=settings.predictor(),
        lead_ticks=lead_ticks(settings),
        prediction_gain=chosen.prediction_gain,
        played=_played_force(settings, felt),
    )
    driven = device(tool, judged.loop.stiffness_N_m)
    motion = HandMotion(driven, tool, settings.limits, rendering, script)
    notes = [judged.sentence()]
    if turning:
        notes.append(turning.sentence())
    notes.append(f"{factor:g} N at the device for each newton at the tool{how}")
    if scale != 1.0:
        notes.append(
            f"{scale:g} m at the tool for each metre at the device; at the device, stiffness is "
            f"{scale * factor:g} times and torque {factor / scale:g} times the value at the tool"
        )
    if settings.output.cue_N > 0.0:
        notes.append(f"cues of {settings.output.cue_N:g} N mark contacts, layers and punctures")
    if felt is not None:
        notes.append(felt.sentence)
    loops = [judged, turning] if turning else [judged]
    if released := release_note(settings, loops):
        notes[-1] += f". {released}"
    return motion, notes


def _law(settings: LoopSettings, loop: WallLoop) -> Renderer:
    """Return the rendering law that computes the contact force in every tick.

    The law is evaluated in every tick, even if the device has fewer than 1000 samples per second.
    """
    return renderer(settings.held.renderer, replace(loop, tick_s=TICK_S))


def _played_force(settings: LoopSettings, perception: Perception | None) -> PlayedForce:
    """Return the object that processes a force before it is sent to the device.

    The object applies the perceptual map, and adds the vibration of a cutter's teeth and the
    transients that signal a contact or puncture.
    """
    limits = settings.limits
    limit_N = limits.force_limit_N
    slew_N = 1e3 * TICK_S * limits.force_slew_N_ms
    cue_N = settings.output.cue_N
    vibration = cues = None
    if teeth := settings.vibration(TICK_S):
        vibration = PlayedVibration(teeth, limit_N=limit_N, slew_N=slew_N)
    if cue_N > 0.0:
        cues = Cues(cue_N, limit_N=limit_N, slew_N=slew_N)
    return PlayedForce(limit_N, perception=perception, vibration=vibration, cues=cues)
