"""Measures of a trial on arrays.

A perfect force scores perfect, and no measure depends on the axes.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue import load_scene
from tissue.evaluation.study import trial_metrics as measures
from tissue.perception.observer import reference_observer
from tissue.scene.load import changed

TICKS = 1200
IDENTITY, NOWHERE = np.eye(3), np.zeros(3)


class Columns(dict):
    """Columns of a trace by name."""

    columns = ()

    def vectors(self, name, unit):
        return self[f"{name}_{unit}"]


def walk(rng, size):
    """A smooth path of three components."""
    steps = np.cumsum(rng.normal(size=(TICKS, 3)), axis=0)
    return size * np.apply_along_axis(np.convolve, 0, steps, np.ones(40) / 40.0, mode="same")


@pytest.fixture
def score(monkeypatch):
    """Measures of arrays, seen in a frame that is turned (or mirrored) and moved."""
    rng = np.random.default_rng(5)
    points = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 5]])
    tip = np.linspace(0, 1, TICKS)[:, None] * points[-1] + 0.05 * walk(rng, 1.0)
    ideal = np.array([0.0, 0, 2.0]) + 0.02 * walk(rng, 1.0)

    def of(played, *, turn=IDENTITY, shift=NOWHERE):
        corners = (points @ turn.T + shift).tolist()
        scene = changed(load_scene("wall"), {"motion.points_mm": corners})
        trace = Columns(
            time_s=1e-3 * np.arange(TICKS),
            hand_force_N=np.vstack([np.zeros(3), played[:-1]]) @ turn.T,
            velocity_mm_s=np.gradient(tip, 1e-3, axis=0) @ turn.T,
            tool_mm=tip @ turn.T + shift,
        )
        trace["hand_force_N"] = np.vstack([trace["hand_force_N"], np.zeros(3)])
        forces = [each @ turn.T for each in (played, ideal, ideal)]
        monkeypatch.setattr(measures, "ideal_force_N", lambda run, cores: None)
        monkeypatch.setattr(measures, "motor_forces", lambda run, ideal_N: (*forces, None))
        run = SimpleNamespace(scene=scene, trace=trace, events=[])
        return measures.measured(run, "T2", reference_observer(), wanted_mm=np.array(corners))

    return of, ideal, tip


def test_a_perfect_force_scores_perfect_and_a_wrong_one_does_not(score):
    of, ideal, _ = score
    perfect = of(ideal)
    for name in (
        "force_error",
        "least_error",
        "excess_error",
        "force_mae_N",
        "force_rms_N",
        "ratio_floor",
    ):
        assert perfect[name] == pytest.approx(0.0, abs=1e-12), name
    assert perfect["latency_ms"] == pytest.approx(0.0, abs=0.05)
    late = of(np.vstack([np.repeat(ideal[:1], 12, axis=0), ideal[:-12]]))
    assert late["latency_ms"] == pytest.approx(12.0, abs=0.05) and late["force_error"] > 0.002
    assert of(1.3 * ideal)["force_error"] == pytest.approx(0.3)


@pytest.mark.parametrize("mirrored", [False, True], ids=["turned", "mirrored"])
def test_no_measure_depends_on_the_frame(score, mirrored):
    of, ideal, _ = score
    rng = np.random.default_rng(8)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn)) * (-1.0 if mirrored else 1.0)
    played = 0.9 * np.roll(ideal, 5, axis=0) + 0.01 * rng.normal(size=ideal.shape)
    before = of(played)
    after = of(played, turn=turn, shift=np.array([100.0, -40.0, 7.0]))
    assert before.keys() == after.keys() and before["force_error"] > 0.05
    for name, value in before.items():
        assert after[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name
