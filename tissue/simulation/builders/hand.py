"""Motion of a scene made by a simulated hand on a device."""

from collections.abc import Callable
from math import ceil

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.paths.toolpath import arc_length
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, HandParameters, Path, waypoints
from tissue.haptics.hand.pushing import CompensatedPath, Thrust
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.proxy.held_tool import HeldTool
from tissue.haptics.proxy.probing_tool import ProbingTool
from tissue.motion.motion import Motion, quaternion_of
from tissue.scene.coupling import WallAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion, ThrustMotion, Tool
from tissue.simulation.builders.device_motion import device_motion
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.builders.loop import person_of
from tissue.simulation.builders.loop_settings import loop_settings
from tissue.simulation.builders.motions import plays_record

__all__ = ["hand_motion"]


Array = NDArray[np.float64]
STRAY_M = 2e-3
"""Largest distance of an organ's surface from the scripted path [m]."""


def hand_motion(
    scene: Scene, scripted: Motion, *, step_s: float, allow_unstable: bool
) -> tuple[HandMotion, str]:
    """Return the scene's motion made by its hand on its device, and notes on the choices made.

    Raises
    ------
    InputError
        If the coupling is unstable and that is not allowed, or the motion leaves the device's
        workspace.
    """
    settings = loop_settings(scene)
    limits = settings.limits
    person = settings.person
    scale = scene.held.coupling.motion_scale
    if not plays_record(scene):
        _require_workspace(scene, scripted, limits)
    start = scripted.sweep_m()[0]
    rng, feeling = np.random.default_rng(scene.seed).spawn(2)

    def device(tool: HeldTool, stiffness_N_m: float) -> SimulatedDevice:
        """Return the device in the scene's hand, which makes the scripted motion."""
        path, push = _aims(scene, scripted, tool, limits, person, stiffness_N_m, step_s=step_s)
        turn = _turn(scripted, step_s=step_s) if isinstance(scene.motion, ReplayMotion) else None
        at_device: Path = lambda time_s: start + (path(time_s) - start) / scale  # noqa: E731
        hand = Hand(person, at_device, rng=rng, step_s=settings.sample_s, push=push, turn=turn)
        x, y, z = start.tolist()
        return SimulatedDevice(limits, hand, position_m=(x, y, z))

    scale_and_note = chosen_scale(scene)
    motion, notes = device_motion(
        settings,
        scripted,
        device,
        force_scale=scale_and_note[0],
        scale_note=scale_and_note[1],
        stray_m=_stray_m(scene),
        after_s=person.reaction_s + person.submovement_s + person.correction_s,
        rng=feeling,
        step_s=step_s,
        allow_unstable=allow_unstable,
    )
    return (
        motion,
        (
            f"{scene.held.kind} in the hand of {person_of(scene.held.hand)}, "
            f"{scene.held.renderer}: {'; '.join(notes)}"
        ),
    )


def _stray_m(scene: Scene) -> float:
    """Return the distance around the scripted motion within which tissue is prepared [m]."""
    if scene.held.coupling.roam_mm is not None:
        return 1e-3 * scene.held.coupling.roam_mm
    return (
        0.0 if isinstance(scene.tool, Tool) or isinstance(scene.anatomy, WallAnatomy) else STRAY_M
    )


def _require_workspace(scene: Scene, scripted: Motion, limits: DeviceParameters) -> None:
    """Refuse a motion that leaves the device's workspace.

    The sides of the workspace box may be assigned to any axes of the motion.
    """
    workspace = limits.workspace_m
    extent = np.sort(np.ptp(scripted.sweep_m(), axis=0))
    scale = scene.held.coupling.motion_scale
    if (extent > scale * workspace).any():
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
    limits: DeviceParameters,
    person: HandParameters,
    stiffness_N_m: float,
    *,
    step_s: float,
) -> tuple[Path, Callable[[float], Array] | None]:
    """Return the path that the hand aims at, and the additional push of the hand (or None)."""
    corners = scripted.sweep_m()
    scale = scene.held.coupling.motion_scale
    furthest = scale * limits.force_limit_N * (1.0 / stiffness_N_m + 1.0 / person.stiffness_N_m)
    if isinstance(scene.motion, ThrustMotion):
        push_N = min(chosen_scale(scene)[0] * scene.motion.thrust_N, limits.force_limit_N)
        thrust = Thrust(
            corners[0], corners[-1] - corners[0], tool, push_N, scale * push_N / stiffness_N_m
        )
        return thrust.path, thrust.push
    path = waypoints(
        *_timed(scripted, recorded=isinstance(scene.motion, ReplayMotion), step_s=step_s)
    )
    if isinstance(scene.anatomy, WallAnatomy) or isinstance(tool, ProbingTool):
        return path, None  # no force moves a tool into a wall or a bone
    return CompensatedPath(
        path, tool, person.submovement_s - 0.5 * person.correction_s, furthest
    ), None


def _turn(scripted: Motion, *, step_s: float) -> Callable[[float], Array]:
    """Return turns of a recorded motion from its first orientation.

    They are unit quaternions over time [s].
    """
    turns = scripted.rotations()
    quaternions = np.array([quaternion_of(turn @ turns[0].T) for turn in turns])
    return lambda time_s: quaternions[min(round(time_s / step_s), len(quaternions) - 1)]


def _timed(scripted: Motion, *, recorded: bool, step_s: float) -> tuple[Array, Array]:
    """Return times [s] and points [m] of a motion.

    A recorded motion has one point per tick; a path is followed at its feed.
    """
    corners_m = scripted.sweep_m()
    if recorded:
        return step_s * np.arange(len(corners_m), dtype=np.float64), corners_m
    along = arc_length(corners_m)
    keep = np.diff(along, prepend=-1.0) > 0.0
    times = along * (scripted.duration_s / along[-1])
    return times[keep], corners_m[keep]
