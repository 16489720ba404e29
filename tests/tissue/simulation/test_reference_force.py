"""Score of a run at the motor.

The tests cover the ideal force in closed form, a perfect predictor, and wrong predictors of known
error.
"""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.evaluation.statistics.metrics import excess_error, force_error, latency_ms
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.hand_motion import Rendering
from tissue.prediction.predictor import Hold
from tissue.simulation.builders import hand
from tissue.simulation.builders.loop import lead_ticks, loop_settings
from tissue.simulation.reference_force import ideal_force_N, motor_forces, stretch_force_N

STEP_M = 5.5e-5
STIFFNESS_N_M, WALL_N_M = 400.0, 1e4
TICKS = 2000


class Stepped(RecordedDevice):
    """A ball that presses twice and trembles, read in steps of an encoder; it feels no force."""

    def __init__(self):
        time = 1e-3 * np.arange(TICKS)
        deep = 5e-3 * np.sin(2.0 * np.pi * time) + 2e-4 * np.sin(2.0 * np.pi * 9.0 * time)
        self.truth_m = np.column_stack([3e-4 * np.sin(7.0 * time), 0.0 * time, 2e-3 + deep])
        super().__init__(time, STEP_M * np.round(self.truth_m / STEP_M))

    def read(self, time_s):
        self.true_position_m = tuple(self.truth_m[min(round(1e3 * time_s), TICKS - 1)].tolist())
        return super().read(time_s)

    true_position_m = (0.0, 0.0, 2e-3)
    hand_force_N = (0.0, 0.0, 0.0)


class Oracle(Hold):
    """Knows the forces that are to come, and gives so much of them."""

    def __init__(self, forces_N, share=1.0):
        super().__init__()
        self.forces_N, self.share, self.seen = forces_N, share, -1

    def observe(self, position_m, velocity_m_s, force_N):
        self.seen += 1

    def predict(self, ticks):
        at = np.arange(len(self.forces_N))
        return self.share * np.array(
            [np.interp(self.seen + ticks, at, axis) for axis in self.forces_N.T]
        )


def run_with(monkeypatch, predictor, **changes):
    entries = {
        "device": "touch",
        "coupling.stiffness_N_m": STIFFNESS_N_M,
        "coupling.delay_ms": 4,
        "coupling.force_scale": 1.0,
        "prediction": "hold",
    }
    monkeypatch.setattr(
        hand, "Rendering", lambda **named: Rendering(**(named | {"predictor": predictor}))
    )
    scene = load_scene("wall", entries | {"duration_s": 1e-3 * TICKS} | changes)
    return simulate(scene, device=Stepped(), allow_unstable=True)


@pytest.fixture(scope="module")
def held():
    with pytest.MonkeyPatch.context() as patch:
        run = run_with(patch, Hold())
    return run, ideal_force_N(run)


def test_the_ideal_force_is_that_of_two_springs_at_the_true_position(held):
    run, ideal = held
    series = 1.0 / (1.0 / STIFFNESS_N_M + 1.0 / WALL_N_M)
    truth = 1e-3 * run.trace.vectors("device_true", "mm")[:, 2]
    np.testing.assert_allclose(ideal[:, 2], series * np.maximum(0.0, -truth), atol=1e-9)
    stepped = series * np.maximum(0.0, -1e-3 * run.trace["device_z_mm"])
    np.testing.assert_allclose(stretch_force_N(run)[:, 2], stepped, atol=1e-9)
    assert np.abs(stepped - ideal[:, 2]).max() > 0.4 * STEP_M * series


@pytest.mark.parametrize("delay_ms", [0, 4])
def test_the_spring_of_a_tool_that_cuts_pulls_from_the_observed_position(delay_ms):
    """The spring of a tool that cuts pulls from the observed position.

    Without a damper at the device, its force is the raw force of the run.
    """
    entries = {
        "device": "touch",
        "prediction": "none",
        "coupling.delay_ms": delay_ms,
        "duration_s": 0.6,
        "voxels.spacing_mm": 0.5,
    }
    run = simulate(load_scene("milling", entries))
    assert run.scene.held.coupling.damping_N_s_m == 0.0
    raw = run.trace.vectors("raw_force", "N")
    # Positions in the trace are in millimetres, which rounds them to 1e-13 of a metre.
    np.testing.assert_allclose(stretch_force_N(run), raw, atol=1e-11)
    assert np.abs(raw).max() > 0.01


def test_a_perfect_predictor_has_the_least_error_and_no_latency(held, monkeypatch):
    run, ideal = held
    forces = motor_forces(run_with(monkeypatch, Oracle(stretch_force_N(run))), ideal)
    error, least = (force_error(each, forces.ideal) for each in (forces.played, forces.nearest))
    assert excess_error(error, least) < 1e-6 and 1e-3 < least < 0.02
    assert latency_ms(forces.played, forces.ideal, tick_s=1e-3) == pytest.approx(0.0, abs=0.05)


def test_wrong_ones_have_their_known_errors_and_latencies(held, monkeypatch):
    run, ideal = held
    forces = motor_forces(run, ideal)
    assert latency_ms(forces.played, forces.ideal, tick_s=1e-3) == pytest.approx(
        lead_ticks(loop_settings(run.scene)), abs=0.1
    )
    for share in (0.0, 1.3):
        wrong = motor_forces(run_with(monkeypatch, Oracle(stretch_force_N(run), share)), ideal)
        error, least = (force_error(each, wrong.ideal) for each in (wrong.played, wrong.nearest))
        # What the steps are off has little to do with the force: 1 % of it at most.
        assert excess_error(error, least) == pytest.approx(abs(share - 1.0), abs=0.01)


@pytest.mark.parametrize("early", [-1.5, 1.5])
def test_another_lead_is_seen_in_the_score(held, monkeypatch, early):
    """Another lead is seen in the score.

    Asked 1.5 ticks too far ahead, the force comes 1.5 ms early, and has a larger error than at the
    path's own lead.
    """
    run, ideal = held
    monkeypatch.setattr(hand, "lead_ticks", lambda settings: lead_ticks(settings) + early)
    forces = motor_forces(run_with(monkeypatch, Oracle(stretch_force_N(run))), ideal)
    assert latency_ms(forces.played, forces.nearest, tick_s=1e-3) == pytest.approx(-early, abs=0.05)
    assert force_error(forces.played, forces.ideal) > 1.1 * force_error(
        forces.nearest, forces.ideal
    )
