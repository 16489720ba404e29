"""Simulated hands that press or tap a rigid wall: runs that several pages share."""

from collections.abc import Callable, Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.training.recording import Recording
from tissue.haptics.device.device import Device, Sample, device_parameters
from tissue.haptics.device.recorded import Fault, FaultyDevice
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters, waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import WallRun, press_wall
from tissue.prediction.koopman import Koopman, OperatorPath
from tissue.prediction.predictor import Contact
from tissue.prediction.trained import Trained

__all__ = [
    "FAULT_S",
    "OMNI",
    "SIX_DOF",
    "STIFFNESS_N_M",
    "TICK_S",
    "TURN",
    "koopman",
    "pressed",
    "relative_error",
    "tapped",
]

OMNI = device_parameters("omni")
SIX_DOF = device_parameters("six-dof")
TICK_S = 1e-3
STIFFNESS_N_M = 1500.0
"""Stiffness of the wall that is pressed [N/m]."""
FAULT_S = 0.15
"""Start of the faults [s], when the hand is at rest in the wall."""
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0
"""Rotation of the tapped wall in the world. It makes all components of position and force vary."""


def pressed(
    faults: Sequence[Fault] = (),
    *,
    seconds: float,
    guarded: bool,
    change: Callable[[Sample], Sample] | None = None,
) -> tuple[WallRun, SampleGuard | None]:
    """Run an expert who leans on a wall, 5 mm deep.

    Parameters
    ----------
    faults
        Scheduled faults of the device.
    seconds
        Duration of the run [s].
    guarded
        If true, samples pass the sample guard, as in the engine.
    change
        Change of the single sample at `FAULT_S`.
    """
    path = waypoints(np.array([0.0, 1e-3]), np.full((2, 3), (0.0, 0.0, -5e-3)))
    hand = Hand(hand_parameters("expert"), path, rng=np.random.default_rng(7))
    simulated = SimulatedDevice(OMNI, hand, position_m=(0.0, 0.0, 0.0))
    guard = SampleGuard(force_limit_N=OMNI.force_limit_N) if guarded else None
    device: Device = (
        FaultyDevice(simulated, faults) if change is None else _Changed(simulated, change)
    )
    return press_wall(
        device, renderer("penalty", OMNI.loop(STIFFNESS_N_M)), duration_s=seconds, guard=guard
    ), guard


class _Changed:
    """Device with one changed sample."""

    in_process = True

    def __init__(self, device: Device, change: Callable[[Sample], Sample]) -> None:
        self._device = device
        self._change = change
        self.command = device.command

    def read(self, time_s: float) -> Sample | None:
        """Return the sample, changed at `FAULT_S`."""
        sample = self._device.read(time_s)
        return (
            self._change(sample)
            if sample is not None and abs(time_s - FAULT_S) < 0.5 * TICK_S
            else sample
        )


def tapped(stiffness_N_m: float, *, seed: int, seconds: float) -> Recording:
    """Record positions, velocities and forces of a novice who taps a wall and leans on it."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds + 2.0, 0.35)
    depths = np.where(np.arange(len(times)) % 2, -rng.uniform(2e-3, 8e-3, len(times)), 4e-3)
    points = np.column_stack([2e-3 * np.sin(times), 2e-3 * np.cos(1.3 * times), depths])
    hand = Hand(hand_parameters("novice"), waypoints(times, points), rng=rng)
    simulated = SimulatedDevice(SIX_DOF, hand, position_m=(0.0, 0.0, 4e-3))
    run = press_wall(
        simulated, renderer("penalty", SIX_DOF.loop(stiffness_N_m)), duration_s=seconds
    )
    position = run.position_m @ TURN.T
    force = run.force_N @ TURN.T
    seen = [
        Contact(stiffness_N_m, p + f / stiffness_N_m, f).row()
        for p, f in zip(position, force, strict=True)
    ]
    return Recording(
        position, np.gradient(position, TICK_S, axis=0), force, np.array(seen), "novice", seed
    )


def koopman(trained: Trained) -> Koopman:
    """Return the predictor of the loop without its guard."""
    return Koopman(OperatorPath(trained.operator, growth=trained.growth))


def relative_error(predictions: Array, force: Array, horizon: int) -> float:
    """Return the error of predictions over the size of the force, at most 1e6.

    The first 100 ticks are left out.
    """
    later = force[100 + horizon :]
    predicted = predictions[100 : len(predictions) - horizon]
    error = float(np.linalg.norm(predicted - later) / np.linalg.norm(later))
    return min(float(np.nan_to_num(error, nan=1e6, posinf=1e6)), 1e6)
