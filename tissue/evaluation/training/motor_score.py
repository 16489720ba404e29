"""A predictor on a recorded run, scored where the motor acts, for any latency of the loop."""

from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array
from tissue.builders.loop import motor_path
from tissue.builders.loop_settings import loop_settings
from tissue.evaluation.statistics.metrics import excess_error, force_error, latency_ms
from tissue.evaluation.training.evaluation import forecast
from tissue.evaluation.training.recording import Recording
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.loop.motor_path import force_later_N, mean_over_ticks_N, motor_force_N, motor_lag_ticks
from tissue.prediction.predictor import Predictor
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.reference_force import ideal_scene
from tissue.simulation.simulate import TICK_S, simulate

__all__ = ["MotorScore", "motor_score", "recorded_ideal_N"]


@dataclass(frozen=True)
class MotorScore:
    """Errors of the force at the motor, as shares of the ideal one, and its latency.

    Attributes
    ----------
    error
        ||F - F_ideal|| / ||F_ideal||.
    least_error
        That of a perfect prediction through the same encoder steps, low-pass and amplifier.
    latency_ms
        How far the force lags that of a perfect prediction [ms]; below zero it comes early.
    """

    error: float
    least_error: float
    latency_ms: float

    @property
    def excess(self) -> float:
        """What the predictor adds to the least error, sqrt(error^2 - least^2)."""
        return excess_error(self.error, self.least_error)


def recorded_ideal_N(scene: Scene, run: Recording) -> Array:
    """Prompt force of a scene at the true positions of its recorded run [N], shape (n, 3).

    Raises
    ------
    InputError
        If the scene has no device.
    """
    times = TICK_S * np.arange(len(run.force_N))
    at = run.position_m if run.true_position_m is None else run.true_position_m
    played_back = RecordedDevice(np.asarray(times, dtype=np.float64), at)
    prompt = ideal_scene(scene).model_copy(update={"duration_s": len(times) * TICK_S})
    return simulate(prompt, allow_unstable=True, device=played_back).trace.vectors("raw_force", "N")


def motor_score(predictor: Predictor, scene: Scene, run: Recording, ideal_N: Array, *, delay_ms: float) -> MotorScore:
    """Score a new predictor on a run, as if its loop had so much latency.

    Parameters
    ----------
    predictor
        One that has seen nothing yet.
    scene
        Gives the low-pass and the device, whose path to the motor the force takes.
    run
        What the predictor sees.
    ideal_N
        See `recorded_ideal_N`, shape (n, 3).
    delay_ms
        Latency besides that of low-pass, transport, hold and amplifier [ms].
    """
    path = motor_path(loop_settings(changed(scene, {"coupling.delay_ms": 0})))
    path = replace(path, delay_s=path.delay_s + 1e-3 * delay_ms)
    lead = motor_lag_ticks(path)
    predicted, _ = forecast(predictor, run, [lead])
    played = motor_force_N(path, predicted[:, 0])[:-1]
    nearest = motor_force_N(path, force_later_N(run.force_N, lead))[:-1]
    ideal = mean_over_ticks_N(ideal_N)
    return MotorScore(
        force_error(played, ideal), force_error(nearest, ideal), latency_ms(played, nearest, tick_s=TICK_S)
    )
