"""A hand that taps a wall: forces to learn from and to predict."""

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.training.recording import Recording
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.prediction.contact import Contact
from tissue.prediction.koopman import Koopman
from tissue.prediction.paths import OperatorPath
from tissue.prediction.trained import Trained

__all__ = ["LIMIT_N", "TICK_S", "koopman", "relative_error", "tapped"]

DEVICE = device_parameters("six-dof")
LIMIT_N, TICK_S = DEVICE.force_limit_N, 1e-3
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0
"""The wall's frame in the world: askew, so that every component of position and force varies."""


def tapped(stiffness_N_m: float, *, seed: int, seconds: float) -> Recording:
    """Positions, velocities and forces at the device of a novice who taps a wall and leans on it."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds + 2.0, 0.35)
    depths = np.where(np.arange(len(times)) % 2, -rng.uniform(2e-3, 8e-3, len(times)), 4e-3)
    points = np.column_stack([2e-3 * np.sin(times), 2e-3 * np.cos(1.3 * times), depths])
    hand = Hand(hand_parameters("novice"), waypoints(times, points), rng=rng)
    simulated = SimulatedDevice(DEVICE, hand, position_m=(0.0, 0.0, 4e-3))
    run = press_wall(simulated, renderer("penalty", DEVICE.loop(stiffness_N_m)), duration_s=seconds)
    position, force = run.position_m @ TURN.T, run.force_N @ TURN.T
    seen = [Contact(stiffness_N_m, p + f / stiffness_N_m, f).row() for p, f in zip(position, force, strict=True)]
    return Recording(position, np.gradient(position, TICK_S, axis=0), force, np.array(seen), "novice", seed)


def koopman(trained: Trained) -> Koopman:
    """The bare predictor of the loop."""
    return Koopman(OperatorPath(trained.operator, growth=trained.growth))


def relative_error(predictions: Array, force: Array, horizon: int) -> float:
    """|predicted - what came| / |what came| over a recording but for its first 100 ticks; capped at 1e6."""
    came, forecast = force[100 + horizon :], predictions[100 : len(predictions) - horizon]
    return min(float(np.nan_to_num(np.linalg.norm(forecast - came) / np.linalg.norm(came), nan=1e6, posinf=1e6)), 1e6)
