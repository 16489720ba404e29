"""Study: predictors as methods, their colours, and the expected time of a run."""

from dataclasses import replace

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue import register
from tissue.cli.study import PlanOptions, run
from tissue.evaluation.looks import METHOD_LOOKS, looks
from tissue.evaluation.study import duration, registration
from tissue.evaluation.study.duration import cost
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import METHODS, TASKS, Plan, TrialKey, method_settings
from tissue.evaluation.study.registration import plan_text
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
    assert METHOD_LOOKS.keys() == METHODS.keys() - set(PREDICTORS)
    built_in = {*METHODS, *PREDICTORS.built_in}
    styles = looks(["own", "other", "third", "fourth"])
    assert built_in <= styles.keys() and len(built_in) == 9
    for index in (0, 1):
        assert len({style[index] for style in styles.values()}) == len(styles)
    # the style of a built-in method does not depend on the other methods
    assert {name: looks()[name] for name in built_in} == {name: styles[name] for name in built_in}


def test_a_study_that_cannot_show_an_effect_says_so_first(monkeypatch):
    small = Plan(trials=3, tasks=("T1", "T2"), groups=("expert",), methods=("penalty", "koopman"))
    (note,) = registration.notes_before(small)
    # 2^(1 - 3), and 0.05 / 17 tests is above 2^(1 - 10)
    assert "with 3 people, its p value is at least 0.25 (1 after" in note
    assert "Plan for 10 people or more" in note
    assert registration.notes_before(replace(small, trials=10)) == []
    (note,) = registration.notes_before(replace(small, trials=1, groups=("novice", "expert")))
    assert note.startswith("Nothing will be tested: each group has one person")
    assert "Plan for 11 people or more" in note
    assert registration.notes_before(replace(small, tasks=("needle",))) == []
    monkeypatch.setattr(registration, "find_spec", lambda name: None)
    (note,) = registration.notes_before(replace(small, trials=10))
    assert "contain no tests, because statsmodels is not installed" in note


def test_a_study_refuses_another_version_of_a_registered_predictor(fading, monkeypatch, tmp_path):
    version = ["my-package 0.1.0, SHA-256 00"]
    monkeypatch.setattr(registration, "package_of", lambda group, name: version[0])
    plan = Plan(trials=1, tasks=("T2",), groups=("expert",), methods=("penalty", fading))
    folder = StudyFolder(tmp_path / "study")
    plan_text.cache_clear()
    folder.begin(plan)
    plan_text.cache_clear()
    assert 'fading = "my-package 0.1.0' in (folder.path / "plan.toml").read_text("utf-8")
    assert folder.begin(plan) == []
    version[0] = "my-package 0.1.0, SHA-256 11"
    with pytest.raises(InputError, match=r"method fading must come from .*SHA-256 00.*SHA-256 11"):
        folder.begin(replace(plan, trials=2))


def test_a_study_refuses_a_changed_predictor_of_a_script(fading, monkeypatch, tmp_path):
    plan = Plan(trials=1, tasks=("T2",), groups=("expert",), methods=("penalty", fading))
    folder = StudyFolder(tmp_path / "study")
    plan_text.cache_clear()
    folder.begin(plan)
    plan_text.cache_clear()
    assert 'fading = "Fading of a script, SHA-256 ' in (folder.path / "plan.toml").read_text()
    monkeypatch.setattr(registration, "getsource", lambda make: "class Fading: changed = True")
    with pytest.raises(InputError, match=r"method fading must come from the registered code"):
        folder.begin(replace(plan, trials=2))

    def unreadable(make):
        raise OSError

    monkeypatch.setattr(registration, "getsource", unreadable)
    with pytest.raises(InputError, match="got code without a source file"):
        folder.begin(replace(plan, trials=2))
    plan_text.cache_clear()


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


def test_a_study_without_a_successful_trial_prints_the_reason_and_no_next_step(
    fading, tmp_path, capsys
):
    """The worker process does not run this file, so that it does not know the predictor."""
    options = PlanOptions(trials=1, tasks=("T2",), groups=("expert",), methods=("penalty", fading))
    run(options=options, workers=1, out=tmp_path / "study")
    text = capsys.readouterr().out
    assert "first failure: penalty: InputError: " in text
    assert "got fading. Choose one of these (T2-expert-0000)" in text
    assert "next:" not in text
