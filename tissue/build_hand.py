"""Put a scene's motion into a hand on a device."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError
from tissue.coupling.aim import Path, waypoints
from tissue.coupling.device import DeviceParameters, device_parameters
from tissue.coupling.guidance import Lead, Thrust
from tissue.coupling.hand import Hand, HandParameters, hand_parameters
from tissue.coupling.hand_motion import HandMotion
from tissue.coupling.held_tool import CuttingTool, HeldTool, PressingTool
from tissue.coupling.loop import WallLoop
from tissue.coupling.renderer import renderer
from tissue.coupling.rotation import quaternion_of
from tissue.coupling.simulated_device import SimulatedDevice
from tissue.coupling.stability import Verdict, critical_stiffness_N_m, in_hands, judge
from tissue.motion import Motion
from tissue.perception import Perception
from tissue.prediction import Predictor
from tissue.scene import Scene
from tissue.scene_coupling import WallAnatomy
from tissue.scene_tool import ReplayMotion, ThrustMotion, Tool

__all__ = ["by_hand", "judged_loop"]

Array = NDArray[np.float64]
STRAY_M = 2e-3
"""How far from the scripted way an organ's surface may be met [m]."""
SHARE = 0.5
"""Share of the critical stiffness that is chosen where a scene gives none."""


def by_hand(scene: Scene, scripted: Motion, *, step_s: float, allow_unstable: bool) -> tuple[HandMotion, str]:
    """The scene's motion as its hand makes it on its device, and what was chosen and found of that.

    Raises
    ------
    InputError
        If the coupling is unstable and that is not allowed.
    """
    limits, person, chosen = device_parameters(scene.device), hand_parameters(scene.hand), scene.coupling
    judged = judged_loop(scene, step_s=step_s)
    verdict = judge(judged, [person.grip[:3]])
    stiffness, told = judged.stiffness_N_m, verdict.sentence(judged.stiffness_N_m)
    alone = critical_stiffness_N_m(judged)
    if stiffness >= alone:
        told += f", but only in a hand: let go, nothing but friction stops its ringing from {alone:.3g} N/m on"
    if not verdict.stable and not allow_unstable:
        raise InputError(_refusal(scene, verdict, stiffness))
    loop = _loop(scene, limits).with_stiffness(stiffness)
    cuts, start = isinstance(scene.tool, Tool), scripted.sweep_m()[0]
    tool: HeldTool = (CuttingTool if cuts else PressingTool)(stiffness / chosen.force_scale, start)
    path, push = _aims(scene, scripted, tool, limits, person, stiffness, step_s=step_s)
    rng, feeling = np.random.default_rng(scene.seed).spawn(2)
    turn = _turn(scripted, step_s=step_s) if isinstance(scene.motion, ReplayMotion) else None
    hand = Hand(person, path, rng=rng, step_s=1.0 / limits.rate_Hz, push=push, turn=turn)
    x, y, z = start.tolist()
    motion = HandMotion(
        SimulatedDevice(limits, hand, position_m=(x, y, z)),
        tool,
        renderer(scene.renderer, loop),
        scripted=scripted,
        limits=limits,
        loop=loop,
        delay_ticks=chosen.delay_ms,
        torque_scale=chosen.force_scale,
        margin=verdict.margin,
        stray_m=0.0 if cuts or isinstance(scene.anatomy, WallAnatomy) else STRAY_M,
        after_s=person.reaction_s + person.submovement_s,
        model_ticks=chosen.model_ms,
        predictor=_predictor(scene, limits),
        lead_ticks=chosen.delay_ms + round(scene.output.low_pass_ms + 1e3 * limits.transport_delay_s),
        perception=_perception(scene, limits, feeling),
    )
    return motion, (
        f"{scene.device} in the hand of {_a(scene.hand)}, {scene.renderer}: {told}; "
        f"{chosen.force_scale:g} N at the device for each newton at the tool"
    )


def _predictor(scene: Scene, limits: DeviceParameters) -> Predictor | None:
    """What tells the force ahead."""
    if scene.prediction == "none":
        return None
    from tissue.prediction.build import predictor

    return predictor(
        scene.prediction,
        scene_name=scene.name,
        file=scene.coupling.predictor_file,
        force_limit_N=limits.force_limit_N,
        tick_s=1.0 / limits.rate_Hz,
    )


def _perception(scene: Scene, limits: DeviceParameters, rng: np.random.Generator) -> Perception | None:
    """The person for whom the force is scaled."""
    if scene.perception == "none":
        return None
    from tissue.perception.build import perception

    return perception(scene.perception, rng=rng, force_limit_N=limits.force_limit_N, tick_s=1.0 / limits.rate_Hz)


def judged_loop(scene: Scene, *, step_s: float) -> WallLoop:
    """The loop by which a scene's coupling is judged, with all the delay that is really there.

    A tool that cuts, or presses a tissue that knows its stiffness, answers in the tick of the sample; on another organ
    its balance is found a tick later.
    """
    limits = device_parameters(scene.device)
    loop = _loop(scene, limits)
    if not (isinstance(scene.tool, Tool) or isinstance(scene.anatomy, WallAnatomy)):
        loop = replace(loop, delay_s=loop.delay_s + step_s)
    stiffness = scene.coupling.stiffness_N_m
    if stiffness is None:
        critical = critical_stiffness_N_m(in_hands(loop, [hand_parameters(scene.hand).grip[:3]])[0])
        stiffness = min(SHARE * critical, limits.stiffness_limit_N_m) or limits.stiffness_limit_N_m
    return loop.with_stiffness(stiffness)


def _loop(scene: Scene, limits: DeviceParameters) -> WallLoop:
    """The loop of device, filter and delay."""
    chosen = scene.coupling
    loop = limits.loop(
        1.0,
        wall_damping_N_s_m=chosen.damping_N_s_m,
        filter_s=1e-3 * scene.output.low_pass_ms,
        model_ticks=chosen.model_ms,
    )
    return replace(loop, delay_s=loop.delay_s + 1e-3 * chosen.delay_ms)


def _refusal(scene: Scene, verdict: Verdict, stiffness_N_m: float) -> str:
    """One sentence for an unstable coupling."""
    if verdict.critical_N_m == 0.0:
        return (
            f"coupling.damping_N_s_m must leave some stiffness stable, got {scene.coupling.damping_N_s_m:g}: lower it, "
            "coupling.delay_ms or output.low_pass_ms, or pass --allow-unstable"
        )
    return (
        f"coupling.stiffness_N_m must be below {verdict.critical_N_m:.4g} to be stable with device = {scene.device} in "
        f"the hand of {_a(scene.hand)}, got {stiffness_N_m:g} (margin {100.0 * verdict.margin:.1f} %): use "
        f"{verdict.nearest_N_m:g}, or pass --allow-unstable"
    )


def _a(hand: str) -> str:
    """A person of a group."""
    return f"a{'n' * (hand[0] in 'aeiou')} {hand}"


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
    """Where the hand aims, and what it pushes beside that."""
    corners, furthest = scripted.sweep_m(), limits.force_limit_N * (1.0 / stiffness_N_m + 1.0 / person.stiffness_N_m)
    if isinstance(scene.motion, ThrustMotion):
        push_N = min(scene.coupling.force_scale * scene.motion.thrust_N, limits.force_limit_N)
        thrust = Thrust(corners[0], corners[-1] - corners[0], tool, push_N, push_N / stiffness_N_m)
        return thrust.path, thrust.push
    path = waypoints(*_timed(scripted, recorded=isinstance(scene.motion, ReplayMotion), step_s=step_s))
    if not isinstance(scene.tool, Tool):
        return path, None
    return Lead(path, tool, person.submovement_s - 0.5 * person.correction_s, furthest), None


def _turn(scripted: Motion, *, step_s: float) -> Callable[[float], Array]:
    """Turns of a recorded motion from its first orientation, as unit quaternions over time [s]."""
    turns = scripted.rotations()
    quaternions = np.array([quaternion_of(turn @ turns[0].T) for turn in turns])
    return lambda time_s: quaternions[min(round(time_s / step_s), len(quaternions) - 1)]


def _timed(scripted: Motion, *, recorded: bool, step_s: float) -> tuple[Array, Array]:
    """Times [s] and points [m] of a recorded motion, a point a tick, or of a path at its feed."""
    corners_m = scripted.sweep_m()
    if recorded:
        return step_s * np.arange(len(corners_m), dtype=np.float64), corners_m
    lengths = np.linalg.norm(np.diff(corners_m, axis=0), axis=1)
    keep = np.concatenate([[True], lengths > 0.0])
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    times = along * (scripted.duration_s / along[-1])
    return times[keep], corners_m[keep]
