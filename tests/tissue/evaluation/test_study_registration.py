"""Registered plan.

The tests cover its power against simulation, its hash, and the differences that a report finds.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.evaluation.statistics.error_rates import QUESTIONS
from tissue.evaluation.statistics.planned_power import planned_people, planned_power
from tissue.evaluation.statistics.sign_flips import pair_scores, sign_test_p
from tissue.evaluation.study import tested
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.registration import (
    content_sha256,
    planned_tests,
)
from tissue.evaluation.study.report import registration_section
from tissue.evaluation.study.section import Section
from tissue.evaluation.study.trial import Trial, trial_seed

PLAN = Plan(
    trials=4,
    tasks=("T1", "T2"),
    methods=("penalty", "koopman", "koopman-perception"),
)


def trial(plan, key):
    """A trial whose metrics all differ among people and methods."""
    seed = trial_seed(plan, key)
    rng = np.random.default_rng(seed)
    names = ("force_error", "ratio_error", "position_error_mm")
    rows = tuple(
        {"method": each} | {name: 0.1 + rng.random() for name in names} for each in plan.methods
    )
    return Trial(key, seed, rows, 0.5)


@pytest.fixture
def study(tmp_path):
    """A study that keeps to its plan."""
    folder = StudyFolder(tmp_path / "study")
    folder.begin(PLAN)
    for key in PLAN.all_trials():
        folder.write(trial(PLAN, key))
    return folder


def made(folder):
    """The tests that the report makes of a study."""
    return tested.tests_sections(folder.table("T1", "T2"), np.random.default_rng(0))[:1]


def as_planned(plan):
    """A section that holds all planned tests."""
    rows = [each.split(" ", 1) for each in planned_tests(plan)]
    table = [{"task": task, "question": question} for task, question in rows]
    return [Section("tests", "Tests", (), table)]


def differences(folder, tests=None):
    rows = registration_section(folder, as_planned(folder.plan()) if tests is None else tests).rows
    return {kind: f"{what}: {detail}" for kind, what, detail in rows}


def test_planned_power_is_that_of_sign_flips():
    """The planned power agrees with sign flips in 3,000 populations.

    They are of three groups of ten people under four methods. Three standard errors of a share are
    0.027, and 199 flips find up to 0.02 less.
    """
    rng, people, groups, methods, count = np.random.default_rng(0), 10, 3, 4, 3_000
    labels = np.repeat(np.arange(groups), people)
    null = rng.standard_normal((count, groups * people, methods))
    expected = planned_power(people, groups, methods, alpha=0.05, rng=rng, effect=0.8)
    # One standard deviation of differences is sqrt(2) of a value's; that of a person's mean is
    # sqrt(1 / methods).
    planted = {name: np.zeros((groups * people, methods)) for name in QUESTIONS}
    planted["method"][:, 1] = 0.8 * 2**0.5
    planted["group"][labels == 1] = 0.8 * methods**-0.5
    planted["group x method"][labels == 1, 1] = 0.8 * 2**0.5
    assert set(expected) == set(QUESTIONS)
    for name, (chosen, between) in QUESTIONS.items():
        scores = pair_scores(null + planted[name], (methods,), chosen)
        found = np.mean(sign_test_p(scores, labels, between=between, rng=rng) <= 0.05)
        assert -0.047 < found - expected[name] < 0.027, name


def test_power_of_two_methods_is_that_of_the_paired_t_test():
    """d = 0.5 with 34 pairs has a power of 80.8 % (G*Power; Faul et al. 2007)."""
    rng = np.random.default_rng(1)
    # three standard errors of 20,000 populations, and of their critical value
    assert planned_power(34, 1, 2, alpha=0.05, rng=rng, effect=0.5) == {
        "method": pytest.approx(0.808, abs=0.02)
    }
    assert planned_power(1, 3, 4, alpha=0.05, rng=rng) == {}
    assert planned_power(10, 3, 4, alpha=0.05, rng=rng, effect=0.01)["group"] == pytest.approx(
        0.05, abs=0.005
    )
    # 34 people are the smallest number with 80 %
    assert planned_people(1, 2, alpha=0.05, rng=rng, effect=0.5)["method"] in range(32, 37)
    assert planned_people(2, 1, alpha=0.05, rng=rng, effect=0.1) == {}


@pytest.mark.slow
def test_the_report_makes_the_planned_tests(study):
    assert differences(study, made(study)) == {}


def test_an_edited_plan_is_refused(study):
    path = study.path / "plan.toml"
    text = path.read_text("utf-8")
    path.write_text(text.replace("alpha = 0.05", "alpha = 0.10"), "utf-8")
    with pytest.raises(InputError, match=r"plan\.toml"):
        study.begin(PLAN)
    assert differences(study)["plan changed"].startswith("plan.toml: registered as ")
    path.unlink()
    with pytest.raises(InputError, match="got no such file"):
        study.begin(PLAN)
    assert "it is not there" in differences(study)["plan changed"]
    path.write_text(text, "utf-8")
    assert study.begin(PLAN) == [] and differences(study) == {}


def test_a_plan_that_grows_is_registered_anew(study):
    first = (study.path / "plan.toml").read_bytes()
    wider = replace(PLAN, trials=5)
    study.begin(wider)
    assert (study.path / "plan-1.toml").read_bytes() == first
    assert [each["trials_before"] for each in study.registrations()] == [0, 24]
    found = differences(study)
    assert found["plan after the first trial"].startswith("plan.toml: registered after 24 trials")
    assert found["trials missing"].endswith("T2-novice-0004, T2-intermediate-0004, T2-expert-0004")
    assert "registered after 24 trials" in registration_section(study, []).sentences[0]


def test_each_point_in_which_a_study_differs_is_named(study):
    (tests,) = as_planned(PLAN)
    left_out = [f"{task}: koopman is left out, as it equals penalty." for task in ("T1", "all")]
    spoilt = Section("tests", "Tests", left_out, tests.table[1:])
    assert (
        "differs from it in 3 points (tests planned and not made; method left out of tests by the "
        "rule of the plan: T1, all)."
    ) in registration_section(study, [spoilt]).sentences[0]


def test_doctored_trials_are_found(study):
    """Doctored trials are found.

    Changed are a figure, then the seed, the plan's hash and the code's, each with a hash of the
    content that fits again.
    """
    path = study.path / "trials" / "T1-novice-0001.json"
    held = json.loads(path.read_text("utf-8"))
    doctored = json.loads(path.read_text("utf-8"))
    doctored["rows"][1]["force_error"] *= 0.5
    path.write_text(json.dumps(doctored), "utf-8")
    assert differences(study) == {
        "trials changed after they were written": "SHA-256 in their files: 1: T1-novice-0001"
    }
    for name, value, kind in (
        ("seed", 5, "trials of another seed"),
        ("plan_sha256", "0" * 64, "trials of no registered plan"),
        ("code_sha256", "0" * 64, "code changed between trials"),
    ):
        content = {key: each for key, each in held.items() if key != "sha256"} | {name: value}
        path.write_text(json.dumps(content | {"sha256": content_sha256(content)}), "utf-8")
        assert set(differences(study)) == {kind}


def test_missing_failed_and_unplanned_trials_are_listed(study):
    for path in (study.path / "trials").glob("*-expert-*.json"):
        path.unlink()
    key = TrialKey("T2", "novice", 2)
    rows = trial(PLAN, key).rows
    study.write(
        Trial(
            key,
            trial_seed(PLAN, key),
            (*rows[:1], {"method": "koopman", "failure": "ValueError: x"}),
            0.1,
        )
    )
    (study.path / "trials" / "T1-novice-0099.json").write_text("{}")
    found = differences(study)
    assert found["group missing"] == "expert: no trial of it"
    assert (
        found["trials missing"]
        == "T2: 4: T2-expert-0000, T2-expert-0001, T2-expert-0002, T2-expert-0003"
    )
    assert found["trials failed and left out"] == "koopman: ValueError: x: 1: T2-novice-0002"
    assert found["method missing"] == "koopman-perception: 1: T2-novice-0002"
    assert found["trials not planned"] == "files that the report leaves out: 1: T1-novice-0099"
