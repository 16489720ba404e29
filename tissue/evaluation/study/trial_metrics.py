"""Metrics of a run in a study: errors of force, position and intensity, time and smoothness."""

from math import inf, isfinite

import numpy as np

from meshes.base.arrays import Array, Flags
from meshes.base.errors import InputError
from meshes.paths.toolpath import path_distance
from tissue.evaluation.statistics import metrics
from tissue.evaluation.study.puncture import NOTICED
from tissue.perception.observer import Observer, reference_observer
from tissue.scene.tool import PathMotion
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.reference_force import ideal_force_N, motor_forces
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S

ARRIVED_MM = 2.0
"""Distance [mm] of the device from the end of the path below which a task counts as done.

A trembling hand does not stay exactly at the end.
"""
LEAST_N = 1e-3
"""Smallest force that can be felt [N].

Smaller forces are replaced by this value before a logarithm is computed.
"""
TOUCHES = 0.05
"""Ratio of a tick's force to the trial's largest force above which the tick counts as contact.

Ticks with smaller forces are ignored, because ratios of forces are not meaningful at the beginning
and the end of a contact.
"""
WINDOW_S = 0.1
"""Time over which a person averages a force [s]: `integration_s` in perception.toml."""


def measured(run: Run, task: str, person: Observer, *, wanted_mm: Array) -> dict[str, float]:
    """Compute the metrics of a run, keyed by metric name (with unit).

    Parameters
    ----------
    run
        Run in which a hand moves a device.
    task
        Name of the task. The needle and reaming tasks have additional metrics.
    person
        Person who feels the force.
    wanted_mm
        Corners of the target path of the tool [mm], shape (corners, 3).

    Raises
    ------
    InputError
        If the tool touched nothing or only briefly, or if a needle did not puncture the capsule
        before the hand stopped.
    """
    trace = run.trace
    played, ideal, nearest, _ = motor_forces(run, ideal_force_N(run, cores=1))
    skin = trace.vectors("hand_force", "N")[1:]  # of the tick before each row
    size = np.linalg.norm(ideal, axis=1)
    if not size.any():
        raise InputError(
            "tool", "touch the tissue in a trial", "no contact", "check the path of the scene"
        )
    touching = size > TOUCHES * size.max()
    velocity = trace.vectors("velocity", "mm_s")
    tip = trace.vectors("tool", "mm")
    assert isinstance(run.scene.motion, PathMotion)
    arrived_mm = ARRIVED_MM * run.scene.held.coupling.motion_scale
    done = np.linalg.norm(tip - np.array(run.scene.motion.points_mm[-1]), axis=1) < arrived_mm
    # a path may end where it begins: the tool must have left the end before
    took = metrics.completion_time_s(trace["time_s"], done & (np.cumsum(~done) > 0))
    error = metrics.force_error(played, ideal)
    least = metrics.force_error(nearest, ideal)
    found = {
        "force_error": error,
        "least_error": least,
        "excess_error": metrics.excess_error(error, least),
        **intensity_ratios(skin, nearest, ideal, person),
        "force_mae_N": metrics.force_mae_N(played, ideal),
        "force_rms_N": metrics.force_rms_N(played, ideal),
        "latency_ms": metrics.latency_ms(played, nearest, tick_s=TICK_S),
        "position_error_mm": float(path_distance(tip, wanted_mm).mean()),
        "time_s": took if isfinite(took) else float(trace["time_s"][-1]),
        "completed": float(isfinite(took)),
        "acceleration_change_m_s2": metrics.acceleration_change_m_s2(velocity, tick_s=TICK_S),
        "spectral_arc_length": metrics.spectral_arc_length(
            np.linalg.norm(velocity, axis=1), tick_s=TICK_S
        ),
        "peak_force_N": float(size.max()),
        "level_N": float(size[touching].mean()),
        "skin_N": float(np.linalg.norm(skin, axis=1)[touching].mean()),
    }
    if task == "needle":
        found |= _pierced(run)
    # in newtons at the reamer, for the comparison with the paper; `force_rms_N` is at the device
    if task == "reaming":
        found["tracking_rms_N"] = found["force_rms_N"] / chosen_scale(run.scene)[0]
        found |= _reamed(run, touching)
    return found


def _pierced(run: Run) -> dict[str, float]:
    """Return the needle's travel after the puncture of a capsule, and forces at the skin.

    The forces are means over `WINDOW_S` before and after the puncture. If the person does not
    notice the puncture, ``noticed`` is 0, and the travel until the end of the run is returned.
    Raises InputError if the hand stops before the puncture.
    """
    puncture = next((time for time, what in run.events if "capsule" in what), inf)
    noticed = next((time for time, what in run.events if what == NOTICED), inf)
    if puncture == inf or noticed < puncture:
        raise InputError(
            "capsule",
            "be punctured before the hand stops in a trial",
            "no puncture" if noticed == inf else f"a hand that stopped at {noticed:g} s",
            "check the threshold of the hand",
        )
    at = round(puncture / TICK_S)
    window = round(WINDOW_S / TICK_S)
    size = np.linalg.norm(run.trace.vectors("hand_force", "N"), axis=1)
    return {
        "noticed": float(noticed < inf),
        "excess_mm": metrics.excess_travel_mm(-run.trace["tool_z_mm"], puncture_tick=at),
        "capsule_N": float(size[max(0, at - window) : at].mean()),
        "parenchyma_N": float(size[at + 1 : at + 1 + window].mean()),
    }


def _reamed(run: Run, touching: Flags) -> dict[str, float]:
    """Return mean and scatter of a reamer's torque [N m] over the ticks in contact."""
    torque = np.abs(run.trace["model_torque_z_Nm"][:-1][touching])
    windows = [
        part.mean()
        for part in np.array_split(torque, max(1, round(len(torque) * TICK_S / WINDOW_S)))
    ]
    return {"torque_Nm": float(np.mean(windows)), "torque_scatter_Nm": float(np.std(windows))}


def intensity_ratios(
    skin_N: Array, nearest_N: Array, ideal_N: Array, person: Observer
) -> dict[str, float]:
    """Return the errors of perceived intensity ratios for the applied force and three other forces.

    The error is the standard deviation of ln S(F) - ln S_ref(F_ideal) over windows of 0.1 s with
    contact throughout. S is the intensity that the person perceives by Stevens' law, and S_ref the
    intensity that the reference observer perceives. An error of 0.1 means that ratios of perceived
    intensities are wrong by a tenth. A constant factor on the force has no effect on the error.

    Returns
    -------
    dict
        Errors of four forces. ``ratio_error`` is the error of the force at the skin.
        ``ratio_floor`` is the error of a perfect force computed from positions with the same
        encoder steps, and felt by the reference observer. ``ratio_unscaled`` is the error if the
        person feels the ideal force. ``ratio_silent`` is the error of a constant force.
    """
    count = max(len(ideal_N) // round(WINDOW_S / TICK_S), 1)
    sizes = np.linalg.norm(ideal_N, axis=1)
    met = np.array([part.min() for part in np.array_split(sizes, count)]) > TOUCHES * sizes.max()
    # a spread needs two windows
    if met.sum() < 2:
        raise InputError(
            "tool",
            "touch the tissue for some tenths of a second in a trial",
            "a shorter contact",
            "check the path of the scene",
        )

    def logarithm(force_N: Array) -> Array:
        """Return the logarithm of the size of the mean force in each window in contact."""
        means = np.array([part.mean(axis=0) for part in np.array_split(force_N, count)])
        return np.asarray(np.log(np.maximum(np.linalg.norm(means[met], axis=1), LEAST_N)))

    felt, least, meant = map(logarithm, (skin_N, nearest_N, ideal_N))
    beta = reference_observer().beta
    return {
        "ratio_error": float(np.std(person.beta * felt - beta * meant)),
        "ratio_floor": float(np.std(beta * (least - meant))),
        "ratio_unscaled": float(np.std((person.beta - beta) * meant)),
        "ratio_silent": float(np.std(beta * meant)),
    }
