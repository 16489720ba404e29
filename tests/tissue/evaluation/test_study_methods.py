"""Study: predictors as methods, their colours, and the expected time of a run."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue import register
from tissue.evaluation.study import duration
from tissue.evaluation.study.duration import cost
from tissue.evaluation.study.plan import METHODS, TASKS, Plan, TrialKey, method_settings
from tissue.evaluation.study.registration import plan_text
from tissue.evaluation.study.section import COLOURS, colours_of
from tissue.evaluation.study.trial import run_trial, trial_scene
from tissue.scene.registry import PREDICTORS
from tissue.system.progress import duration_text


class Fading:
    """Predictor that returns the present force."""

    def __init__(self):
        self.force_N = np.zeros(3)

    def observe(self, position_m, velocity_m_s, force_N):
        if force_N is not None:
            self.force_N = force_N

    def predict(self, ticks):
        return self.force_N


@pytest.fixture
def fading():
    """A registered predictor, until the test ends."""
    register.predictor("fading", Fading)
    yield "fading"
    PREDICTORS.remove("fading")


def test_a_method_is_a_predictor_that_is_registered():
    with pytest.raises(InputError, match=r"methods must be one of penalty, .* got fading"):
        Plan(methods=("penalty", "fading"))


def test_a_registered_predictor_is_a_method_of_the_registered_plan(fading):
    plan = Plan(methods=("penalty", fading))
    assert method_settings("fading") == {"renderer": "proxy", "prediction": "fading"}
    assert 'fading = "renderer = proxy, prediction = fading"' in plan_text(plan)
    assert plan_text(plan) != plan_text(Plan(methods=("penalty", "kalman")))


@pytest.mark.slow
def test_a_registered_predictor_runs_in_a_trial(fading):
    trial = run_trial(Plan(methods=("penalty", fading)), TrialKey("T2", "expert", 0))
    assert not trial.failed
    assert set(trial.values("force_error")) == {"penalty", "fading"}


def test_only_the_methods_of_the_plan_are_built(tmp_path):
    """The coupling stiffness is the smallest of the methods of the plan."""
    key = TrialKey("T1", "expert", 0)
    found = {}
    for index, methods in enumerate((("penalty",), ("penalty", "koopman-look-ahead"))):
        trial = trial_scene(Plan(methods=methods), key, tmp_path / f"{index}.json")
        assert tuple(trial.scenes) == methods
        found[methods] = {
            scene.held.coupling.stiffness_N_m for scene in trial.scenes.values()
        }.pop()
    alone, both = found.values()
    assert both < alone


def test_methods_have_different_colours():
    assert COLOURS.keys() == METHODS.keys()
    colours = colours_of((*METHODS, "kalman", "linear"))
    assert len(set(colours.values())) == len(METHODS) + 2


def test_the_expected_time_grows_with_trials_and_falls_with_workers(monkeypatch):
    plan = Plan(trials=2)
    keys = list(plan.all_trials())
    assert duration.COSTS.keys() == TASKS.keys()
    monkeypatch.setattr(duration, "probe_s", lambda: 0.1)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    one, two, many = (
        duration.expected_text(plan, keys, workers=workers).partition(" on ")[0]
        for workers in (1, 2, 8)
    )
    assert two == many != one
    assert duration_text(0.1 * cost(plan, keys)) in one
    assert duration_text(0.05 * cost(plan, keys)) in two
    assert cost(plan, keys[:5]) < cost(plan, keys)
    pair = Plan(trials=2, methods=("penalty", "koopman"))
    assert cost(pair, keys) / cost(plan, keys) == pytest.approx(2.0 / len(METHODS))
