"""The force that a device would play if nothing were late, coarse or filtered: what runs by a hand are held against."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.builders.loop import judged_loop
from tissue.haptics.device.recorded import RecordedDevice
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, simulate
from tissue.simulation.trace import Table

__all__ = ["ideal_force_N", "ideal_scene", "played_force_N", "stretch_force_N"]

Array = NDArray[np.float64]
PROMPT: dict[str, object] = {
    "renderer": "proxy",
    "prediction": "none",
    "perception": "none",
    "output.low_pass_ms": 0.0,
    "coupling.delay_ms": 0,
    "coupling.model_ms": 1,
}
"""What makes a loop prompt."""


def ideal_scene(scene: Scene, finest: Mapping[str, object] | None = None) -> Scene:
    """The same scene, prompt, with the same stiffness of the coupling and the finest model.

    Parameters
    ----------
    scene
        A scene with a device.
    finest
        Settings of the converged model by dotted key, such as ``{"voxels.spacing_mm": 0.05}``.

    Raises
    ------
    InputError
        If the scene has no device.
    """
    if scene.device == "none":
        raise InputError("scene must have a device to have a played force, got none: set device, such as touch")
    stiffness = scene.coupling.stiffness_N_m or judged_loop(scene, step_s=TICK_S).stiffness_N_m
    return changed(scene, {**PROMPT, "coupling.stiffness_N_m": stiffness, **(finest or {})})


def ideal_force_N(run: Run, finest: Mapping[str, object] | None = None, *, cores: int | None = None) -> Array:
    """Force on the device that a prompt loop with the finest model gives on the very motion of a run [N], shape (n, 3).

    The motion is that which the device has sampled, so that a hand's reaction to another force is no part of the
    difference. Tissue that is cut differs by what the coarse model has cut otherwise, as it does in a run.

    Raises
    ------
    InputError
        If the run had no device.
    """
    trace = run.trace
    played_back = RecordedDevice(
        trace["time_s"],
        1e-3 * trace.vectors("device", "mm"),
        np.column_stack([trace[f"device_q{c}"] for c in "xyzw"]),
        rate_Hz=1.0 / TICK_S,
    )
    scene = ideal_scene(run.scene, finest).model_copy(update={"duration_s": len(trace.rows) * TICK_S})
    return simulate(scene, cores=cores, allow_unstable=True, device=played_back).trace.vectors("raw_force", "N")


def stretch_force_N(run: Run) -> Array:
    """The same without another run, on the run's own model: the stretch of the coupling's spring [N], shape (n, 3).

    Exact where the tissue answers every tick; a coarse model's own error is left out.

    Raises
    ------
    InputError
        If the run had no device.
    """
    stiffness, trace = ideal_scene(run.scene).coupling.stiffness_N_m, run.trace
    assert stiffness is not None
    return 1e-3 * stiffness * (trace.vectors("tool", "mm") - trace.vectors("device", "mm"))


def played_force_N(trace: Table) -> Array:
    """Force on the device before its range is applied [N], shape (n, 3)."""
    return trace.vectors("filtered_force", "N")
