"""Force that a haptic device would receive from a fine model without latency and filters.

This reference force is compared with the force of a run. The two forces are compared at the motor
of the device, after transport, zero-order hold and amplifier. Each error is reported with a lower
bound. The lower bound is the error of a perfect prediction from the quantised encoder positions,
after the low-pass and the amplifier.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.hints import suggests_arguments
from tissue.haptics.device.device import Sample
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.sample_guard import NewSamples
from tissue.haptics.hand_measures import TRUE, VIBRATION
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.filters import ConstantAcceleration
from tissue.haptics.loop.sampled_loop import (
    WallLoop,
    force_later_N,
    mean_over_ticks_N,
    motor_force_N,
)
from tissue.models.tissue_model import Finishes
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.builders.loop import (
    device_path,
    judged_loop,
    lead_ticks,
    loop_settings,
    motor_path,
)
from tissue.simulation.builders.parts import Parts
from tissue.simulation.loop import Stepper, undisturbed
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, build
from tissue.simulation.trace import LEAST_LOAD

PROMPT: dict[str, object] = {
    "renderer": "proxy",
    "prediction": "none",
    "perception": "none",
    "output.cue_N": 0.0,
    "output.low_pass_ms": 0.0,
    "coupling.delay_ms": 0,
    "coupling.model_ms": 1,
}
"""Settings of a loop without latency, filter, prediction and perception."""


def ideal_scene(scene: Scene, finest: Mapping[str, object] | None = None) -> Scene:
    """Return a copy of a scene that has the finest tissue model, no latency and no filters.

    Parameters
    ----------
    scene
        Scene with a device.
    finest
        Settings of the finest model, keyed by dotted scene key, such as ``{"voxels.spacing_mm":
        0.05}``.

    Raises
    ------
    InputError
        If the scene has no device.
    """
    if scene.device is None:
        raise InputError(
            "device",
            "be given, because the played force is the force on a device",
            "none",
            "set for example device = touch",
        )
    stiffness = scene.held.coupling.stiffness_N_m or judged_loop(loop_settings(scene)).stiffness_N_m
    return changed(scene, {**PROMPT, "coupling.stiffness_N_m": stiffness, **(finest or {})})


def ideal_force_N(
    run: Run, finest: Mapping[str, object] | None = None, *, cores: int | None = None
) -> Array:
    """Compute the force that a loop without latency would give for the device motion of a run.

    The result is the force in each tick [N], shape (n, 3). This ideal loop has the finest model and
    no filters; see `ideal_scene`. The device moves as in the run, so the force does not include the
    reaction of a hand to the ideal force. A simulated device provides its true motion; for other
    devices, the motion that the encoders read is used. The ideal loop simulates the tissue again,
    so more or less tissue may be removed than in the run.

    Raises
    ------
    InputError
        If the run had no device.
    """
    trace = run.trace
    played_back = RecordedDevice(
        trace["time_s"],
        1e-3 * trace.vectors("device_true" if TRUE[0] in trace else "device", "mm"),
        trace.quaternions("device"),
    )
    scene = ideal_scene(run.scene, finest).model_copy(
        update={"duration_s": len(trace.rows) * TICK_S}
    )
    parts = build(scene, cores=cores, allow_unstable=True)
    assert isinstance(parts.motion, HandMotion)
    parts.motion.device = played_back
    return rendered_force_N(parts, len(trace.rows))


def rendered_force_N(parts: Parts, ticks: int) -> Array:
    """Compute the force of the renderer in each tick [N], shape (ticks, 3).

    The result is the force before prediction, filter and delay. It is bit for bit equal to the
    trace columns ``raw_force`` of a run of `parts`. The computation takes about half of the time of
    a run, because all later stages of the force are skipped. The motion of the device must
    therefore not depend on the force.

    Parameters
    ----------
    parts
        Objects that simulate the scene. Their device must not apply a force, and their tissue must
        compute a response in every tick.
    ticks
        Number of ticks.
    """
    motion = parts.motion
    tissue = parts.tissue
    assert isinstance(motion, HandMotion)
    stepper = Stepper(motion, tissue)
    forces = np.zeros((ticks, 3))
    stepper.place()
    with undisturbed():
        for tick in range(ticks):
            stepper.wait(tick)
            stepper.step(tick)
            forces[tick] = motion.raw_force_N()
            stepper.start_background(tick)
    if isinstance(tissue, Finishes):
        tissue.finish()
    forces[np.abs(forces) < LEAST_LOAD] = 0.0
    return forces


def stretch_force_N(run: Run) -> Array:
    """Compute the force of the coupling spring in each tick of a run [N], shape (n, 3).

    The result is the force that the run would have without latency, computed from the run's encoder
    positions and tissue model. For a cutting tool, the estimate of the position observer replaces
    the encoder position; see `WallLoop.observes`. If the tissue model responds in every tick, a
    predictor receives this force.

    Raises
    ------
    InputError
        If the run had no device.
    """
    coupling = ideal_scene(run.scene).held.coupling
    trace = run.trace
    assert coupling.stiffness_N_m is not None
    start_mm = 1e3 * run.parts.motion.sweep_m()[0]
    tool_mm = start_mm + (trace.vectors("tool", "mm") - start_mm) / coupling.motion_scale
    device_mm = trace.vectors("device", "mm")
    loop = judged_loop(loop_settings(run.scene))
    if loop.observes:
        device_mm = _observed(trace["time_s"], device_mm, loop)
    return 1e-3 * coupling.stiffness_N_m * (tool_mm - device_mm)


def _observed(times_s: Array, positions: Array, loop: WallLoop) -> Array:
    """Return the positions that the position observer of a loop estimates, shape (n, 3)."""
    assert loop.velocity_memory is not None
    samples = NewSamples(loop.tick_s)
    observer = ConstantAcceleration(loop.velocity_memory, step_s=loop.tick_s)
    observed = np.empty_like(positions)
    for row, (time_s, position) in enumerate(zip(times_s.tolist(), positions, strict=True)):
        x, y, z = position.tolist()
        # A simulated device gives the times of its samples. 1e-6 allows for a time that is rounded
        # down.
        taken_s = loop.tick_s * int(time_s / loop.tick_s + 1e-6)
        if samples.is_new(Sample(taken_s, (x, y, z)), time_s):
            observer.step(position)
        observed[row] = observer.position
    return observed


class MotorForces(NamedTuple):
    """Mean forces at the motor of a device in each tick except the last one.

    Each force has shape (n - 1, 3), in newtons.

    Attributes
    ----------
    played
        Force of the run, before it is compressed to the range of the device.
    ideal
        Force without latency at the true device position.
    nearest
        Force at the motor if the predictor predicted the result of `stretch_force_N` perfectly. The
        error of this force is the lower bound for forces that are computed from the encoder
        positions. The force of a run may still have a smaller error if the run smooths the encoder
        steps more.
    sent
        Force that the device received, after compression to the device's range and perceptual
        scaling.
    """

    played: Array
    ideal: Array
    nearest: Array
    sent: Array


@suggests_arguments
def motor_forces(run: Run, ideal_N: Array | None = None) -> MotorForces:
    """Compute the force at the motor of a device in a run, and reference forces.

    The reference force `ideal` has no latency, no encoder steps and no filters. It is computed as
    if the device moved exactly as in the run.

    Parameters
    ----------
    run
        Run with a simulated hand. The run must have been simulated in this process, not read from a
        folder.
    ideal_N
        Result of `ideal_force_N`. If it is not given, the scene is simulated again.

    Returns
    -------
    Mean forces in each tick except the last one; see `MotorForces`.

    Raises
    ------
    InputError
        If the run had no device, or was read from a folder.
    """
    if ideal_N is None:
        ideal_N = ideal_force_N(run)
    settings = loop_settings(run.scene)
    after = device_path(settings.limits)
    nearest = motor_force_N(
        motor_path(settings), force_later_N(stretch_force_N(run), lead_ticks(settings))
    )
    played = motor_force_N(after, run.trace.vectors("filtered_force", "N"))
    steady = run.trace.vectors("device_force", "N")
    if VIBRATION[0] in run.trace.columns:
        steady = steady - run.trace.vectors("vibration", "N")
    sent = motor_force_N(after, steady)
    return MotorForces(played[:-1], mean_over_ticks_N(ideal_N), nearest[:-1], sent[:-1])
