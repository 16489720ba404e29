"""Predictors scored at the motor on a recorded run.

They are a perfect one, a zero-order hold, and the same run in closed loop.
"""

import numpy as np
import pytest
from motor_score import motor_score, recorded_ideal_N

from tissue import load_scene, simulate
from tissue.evaluation.statistics.metrics import force_error
from tissue.evaluation.training import Recorder, trial
from tissue.prediction.predictor import Hold
from tissue.simulation.reference_force import ideal_force_N, motor_forces


class Oracle(Hold):
    """Knows the forces that are to come."""

    def __init__(self, forces_N):
        super().__init__()
        self.forces_N, self.seen = forces_N, -1

    def observe(self, position_m, velocity_m_s, force_N):
        self.seen += 1

    def predict(self, ticks):
        at = np.arange(len(self.forces_N))
        return np.array([np.interp(self.seen + ticks, at, axis) for axis in self.forces_N.T])


@pytest.fixture(scope="module")
def wall():
    scene = trial(load_scene("wall"), 41, delay_ms=4)
    run = Recorder().record(scene)
    return scene, run, recorded_ideal_N(scene, run)


@pytest.mark.parametrize("delay_ms", [0, 2, 4, 8.5, 16])
def test_a_perfect_prediction_has_the_least_error_at_any_latency(wall, delay_ms):
    scene, run, ideal = wall
    score = motor_score(Oracle(run.force_N), scene, run, ideal, delay_ms=delay_ms)
    assert score.excess < 1e-6 and 0.0 < score.least_error < 0.02
    assert score.latency_ms == pytest.approx(0.0, abs=1e-6)


def test_who_holds_the_force_is_late_by_the_path(wall):
    scene, run, ideal = wall
    scores = [motor_score(Hold(), scene, run, ideal, delay_ms=delay) for delay in (0, 4, 8)]
    for delay, score in zip((0, 4, 8), scores, strict=True):
        assert score.latency_ms == pytest.approx(delay + 2.11, abs=0.1)
    assert scores[0].excess < scores[1].excess < scores[2].excess


def test_it_is_the_score_of_the_loop_that_made_the_run(wall):
    """The score equals that of the loop that made the run.

    Nothing was predicted during the recording, which is a zero-order hold; low-pass and latency are
    the loop's own.
    """
    scene, run, ideal = wall
    closed, count = simulate(scene), len(ideal) - 1  # a run goes on for as long as the hand is late
    again = ideal_force_N(closed)
    np.testing.assert_allclose(again[:count], ideal[:count], atol=1e-6)
    played, wanted, nearest, _ = (each[:count] for each in motor_forces(closed, again))
    score = motor_score(Hold(), scene, run, ideal, delay_ms=4)
    assert score.error == pytest.approx(force_error(played, wanted), rel=1e-3)
    assert score.least_error == pytest.approx(force_error(nearest, wanted), rel=1e-3)
