"""Study: predictors as methods, their colours, and the expected time of a run."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue import register
from tissue.evaluation.study import duration
from tissue.evaluation.study.duration import cost, expected_s
from tissue.evaluation.study.plan import METHODS, TASKS, Plan, TrialKey, method_settings
from tissue.evaluation.study.registration import plan_text
from tissue.evaluation.study.section import COLOURS, colours_of
from tissue.evaluation.study.trial import run_trial, trial_scene
from tissue.scene.registry import PREDICTORS


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


def test_the_expected_time_grows_with_trials_and_falls_with_workers():
    plan = Plan(trials=2, sensitivity=False)
    keys = list(plan.all_trials())
    assert duration.COSTS.keys() == TASKS.keys()
    one, two, many = (
        expected_s(plan, keys, workers=workers, cores=2, probed_s=0.1) for workers in (1, 2, 8)
    )
    assert one == pytest.approx(0.1 * cost(plan, keys))
    assert two == many == 0.5 * one
    assert expected_s(plan, keys[:5], workers=1, cores=2, probed_s=0.1) < one
    # a variant runs two methods, a study all of them
    pair = [TrialKey("T2", "intermediate", 0), TrialKey("T2", "intermediate", 0, "pace-slow")]
    usual, varied = (cost(plan, [key]) for key in pair)
    assert varied / usual == pytest.approx(2.0 / len(METHODS))
