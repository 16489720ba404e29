"""Motion of a tool coupled to a device.

The module judges the loop, chooses its laws and builds the path from sample to force.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.device.device import Device
from tissue.haptics.hand_motion import HandMotion, Rendering, Script
from tissue.haptics.loop.vibration import Cues, PlayedForce, PlayedVibration
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import HeldTool, HeldTurn, PressingTool
from tissue.haptics.proxy.probing_tool import ProbingTool
from tissue.haptics.renderer import TurningRenderer, renderer
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import Motion
from tissue.perception.perceived import Perception
from tissue.simulation.builders.loop import judged_loops, lead_ticks
from tissue.simulation.builders.loop_settings import LoopSettings

__all__ = ["device_motion"]

DAMPING_S = 0.01
"""Ratio of damper to spring for a tool that cuts [s].

In a pen grip, 4 N s/m over 250 to 350 N/m gives 11 to 16 ms.
"""


def device_motion(
    settings: LoopSettings,
    scripted: Motion,
    device: Callable[[HeldTool, float], Device],
    *,
    force_scale: float,
    scale_note: str = "",
    stray_m: float = 0.0,
    after_s: float = 0.0,
    device_origin_m: Array | None = None,
    rng: np.random.Generator,
    step_s: float,
    allow_unstable: bool,
) -> tuple[HandMotion, list[str]]:
    """Return the motion of a tool on a device, and notes on the choices made.

    Forces are scaled by f and lengths by m, so a stiffness K at the tool is felt as m f K, and
    torques by f / m: work at the device is f / m times the work at the tool. The coupling's
    stiffness is the stiffness at the device, which is judged, whatever the scales.

    Parameters
    ----------
    settings
        Settings of the loop between device and tool.
    scripted
        Gives start, orientation, region and duration.
    device
        Makes the device from the tool coupled to it and the coupling's stiffness [N/m].
    force_scale, scale_note
        Newtons at the device for each newton at the tool, and a note on how the scale was chosen.
    stray_m
        Largest distance of the tool from the scripted motion [m].
    after_s
        Additional time that a hand takes [s].
    device_origin_m
        Tool position when the device is at its origin [m]. Without it both start at the same
        position.
    rng
        Generator of the perceptual noise of the person for whom the force is scaled.
    step_s
        Length of a tick [s].
    allow_unstable
        Whether an unstable coupling is accepted.

    Raises
    ------
    InputError
        If the coupling is unstable and that is not allowed.
    """
    limits = settings.limits
    chosen = settings.coupling
    scale = settings.coupling.motion_scale
    judged, turning = judged_loops(settings, step_s=step_s, allow_unstable=allow_unstable)
    # For the energy balance: from a sample to the force that answers it, without the delay of a
    # balance that is found a tick later.
    loop = replace(judged.loop, delay_s=limits.transport_delay_s + 1e-3 * chosen.delay_ms)
    # for parts that run in every tick, whatever the device's sample rate
    in_ticks = replace(loop, tick_s=TICK_S)
    spring = judged.loop.stiffness_N_m / (scale * force_scale)
    turn = HeldTurn(turning.loop.stiffness_N_m * scale / force_scale if turning else inf)
    tool = _tool(settings, spring, scripted.sweep_m()[0], turn)
    felt = settings.perception(rng)
    turning_law = None
    if turning:
        turning_law = TurningRenderer(
            renderer(settings.renderer, replace(turning.loop, tick_s=TICK_S))
        )
    rendering = Rendering(
        law=renderer(settings.renderer, in_ticks),
        loop=loop,
        margin=judged.verdict.margin,
        turning_law=turning_law,
        delay_ticks=chosen.delay_ms,
        model_ticks=chosen.model_ms,
        predictor=settings.predictor(),
        lead_ticks=lead_ticks(settings),
        prediction_gain=chosen.prediction_gain,
        played=_played(settings, felt),
    )
    script = Script(
        motion=scripted,
        motion_scale=scale,
        stray_m=stray_m,
        after_s=after_s,
        device_origin_m=device_origin_m,
    )
    motion = HandMotion(device(tool, judged.loop.stiffness_N_m), tool, limits, rendering, script)
    notes = [
        judged.sentence(),
        f"{force_scale:g} N at the device for each newton at the tool{scale_note}",
    ]
    if turning:
        notes.insert(1, turning.sentence())
    if scale != 1.0:
        notes.append(
            f"{scale:g} m at the tool for each metre at the device: a stiffness at the tool "
            "is felt as "
            f"{scale * force_scale:g} of it, a torque as {force_scale / scale:g}"
        )
    if settings.cue_N > 0.0:
        notes.append(f"cues of {settings.cue_N:g} N mark contacts, layers and punctures")
    if felt is not None:
        notes.append(felt.sentence)
    return motion, notes


def _tool(settings: LoopSettings, spring_N_m: float, start_m: Array, turn: HeldTurn) -> HeldTool:
    """Return the law of a tool coupled to a device by a spring."""
    if settings.contact == "cuts":
        return CuttingTool(spring_N_m, start_m, turn, damping_N_s_m=DAMPING_S * spring_N_m)
    return (ProbingTool if settings.contact == "touches" else PressingTool)(
        spring_N_m, start_m, turn
    )


def _played(settings: LoopSettings, person: Perception | None) -> PlayedForce:
    """Return the processing of a force before the device.

    It covers perception, and the vibration of a cutter's teeth and event cues at the tool.
    """
    limits = settings.limits
    limit_N = limits.force_limit_N
    slew_N = 1e3 * TICK_S * limits.force_slew_N_ms
    teeth = settings.vibration(TICK_S)
    vibration = (
        None
        if teeth is None
        else PlayedVibration(teeth, limit_N=limit_N, slew_N=slew_N, step_s=TICK_S)
    )
    cues = (
        Cues(settings.cue_N, limit_N=limit_N, slew_N=slew_N, tick_s=TICK_S)
        if settings.cue_N > 0.0
        else None
    )
    return PlayedForce(limits.force_limit_N, perception=person, vibration=vibration, cues=cues)
