"""A hand that taps a wall: forces to learn from and to predict, and operators trained on them."""

from collections.abc import Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.training.recording import Recording
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.prediction.edmd.dictionary import Delays
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.gap_products import GapProducts
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.koopman import Koopman, LoopTerms

__all__ = ["LIMIT_N", "TICK_S", "koopman", "relative_error", "tapped", "trained"]

DEVICE = device_parameters("six-dof")
LIMIT_N, TICK_S, LAGS, LONGEST_HORIZON = DEVICE.force_limit_N, 1e-3, 6, 64
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
    position = run.position_m @ TURN.T
    return Recording(position, np.gradient(position, TICK_S, axis=0), run.force_N @ TURN.T, "novice", seed)


def trained(recordings: Sequence[Recording]) -> Operator:
    """An operator on windows of position and force with the wall's overlap among its observables, capped at 1."""
    nx, ny, nz = TURN[:, 2].tolist()
    dictionary = Delays(LAGS, GapProducts((nx, ny, nz)))
    episodes = [Episode(np.hstack((each.position_m, each.force_N)), None, TICK_S) for each in recordings]
    return Edmd(dictionary, ridge=1e-9, cap=1.0).fit(episodes)


def koopman(operator: Operator) -> Koopman:
    """The predictor of the loop on that operator; it distrusts itself beyond three times its training's error."""
    residual = float(np.sqrt((operator.statistics.residual_rms[3:6] ** 2).sum()))
    terms = LoopTerms(
        gains=(0.0,) * LONGEST_HORIZON, residual_N=3.0 * residual, correction_N=LIMIT_N, quiet_N=0.02, reach_N=LIMIT_N,
        growth=25.0, following=np.zeros((3, 3)),
    )  # fmt: skip
    return Koopman(operator, terms)


def relative_error(predictions: Array, force: Array, horizon: int) -> float:
    """|predicted - what came| / |what came| over a recording but for its first 100 ticks; capped at 1e6."""
    came, forecast = force[100 + horizon :], predictions[100 : len(predictions) - horizon]
    return min(float(np.nan_to_num(np.linalg.norm(forecast - came) / np.linalg.norm(came), nan=1e6, posinf=1e6)), 1e6)
