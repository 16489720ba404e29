"""Report of a study: tables next to the paper's, sentences from the data, missing parts."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from meshes.paths.toolpath import path_distance
from tissue.evaluation.charts.prediction import PredictorComparison
from tissue.evaluation.statistics.intervals import mean_interval, signed_interval
from tissue.evaluation.study.cases import case_sections
from tissue.evaluation.study.fidelity import (
    force_section,
    task_section,
)
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import METHODS, TASKS, Plan, TrialKey
from tissue.evaluation.study.report import found_section, sections_of, write_report
from tissue.evaluation.study.section import PRINTED
from tissue.evaluation.study.trial import Trial
from tissue.evaluation.training import HORIZONS

PLAN = Plan(trials=4, tasks=("T1", "T2", "needle", "reaming", "drilling"))
LEFT = {"penalty": 1.0, "energy": 1.0} | dict.fromkeys(list(METHODS)[2:], 0.4)
"""Fraction of the force error that each method leaves."""


def planted(key, rng):
    """Metrics of a trial: methods differ in force error alone, energy not at all from penalty."""
    shared = {
        "time_s": 3.0 + rng.random(),
        "position_error_mm": 0.7 + 0.1 * rng.random(),
        "completed": 1.0,
        "acceleration_change_m_s2": 2.0 + rng.random(),
        "spectral_arc_length": -3.0 - rng.random(),
        "force_mae_N": 0.1,
        "force_rms_N": 0.1,
        "peak_force_N": 1.0 + rng.random(),
        "specimen": float(key.trial % 2),
        "skin_N": (1.0 + 0.3 * (key.trial % 2)) * (1.0 + 0.01 * rng.random()),
        "level_N": (1.0 + 0.3 * (key.trial % 2)) * (1.0 + 0.01 * rng.random()),
        "excess_mm": 0.5,
        "noticed": 1.0,
        "capsule_N": 2.1 + 0.01 * rng.random(),
        "parenchyma_N": 1.6,
        "tracking_rms_N": 1.0,
        "torque_Nm": 0.5,
        "torque_scatter_Nm": 0.01,
    }
    error = 0.08 * np.exp(0.1 * rng.standard_normal())
    rows = []
    for method, left in LEFT.items():
        made = left * error * (1.0 if left == 1.0 else np.exp(0.05 * rng.normal()))
        latency = 4.3 * left + 0.01 * rng.random() * (left < 1.0)
        felt = {
            "force_error": made,
            "least_error": 0.6 * made,
            "excess_error": 0.8 * made,
            "ratio_error": made + 0.1,
            "ratio_floor": 0.1,
            "latency_ms": latency,
        }
        rows.append({"method": method} | shared | felt)
    return rows


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study with planted differences, one failed method and one group that ends early."""
    folder = StudyFolder(tmp_path_factory.mktemp("study") / "study")
    folder.begin(PLAN)
    for number, key in enumerate(PLAN.all_trials()):
        rows = planted(key, np.random.default_rng(number))
        if key == TrialKey("T1", "expert", 3):
            rows[2] = {"method": "koopman", "failure": "InputError: it was too late"}
        folder.write(Trial(key, number, tuple(rows), 1.5))
    return folder


@pytest.mark.slow
def test_the_report_finds_what_was_planted(study):
    study.write_tables()
    page, message = write_report(study.path)
    text = page.read_text("utf-8")
    assert text.count("<section") >= 11 and text.count("data:image/png;base64,") == 4
    # each has one, and no pictures come of that
    assert "People have too few trials on two specimens each." in text
    assert "http" not in text.replace("http-equiv", "") and "<script" not in text
    assert any(
        "1 failed, koopman: InputError: it was too late (T1-expert-0003)" in each
        for each in message
    )
    # five sentences begin the report
    registered, force, travel, _, papers = message[:5]
    assert registered.startswith("plan.toml was registered before the first trial")
    assert force.startswith(
        "Force error with prediction, divided by the force error of the penalty law: T1 0.4"
    )
    range_text = "0.50 mm (penalty) to 0.50 mm (penalty), and at least 100 %"
    assert f"travel after the puncture is {range_text}" in travel
    assert papers.startswith("Results that agree with the paper: ")
    first = text[text.index('<section id="found"') : text.index('<section id="overview"')]
    assert first.count('class="verdict"') == 5
    assert "noticed in 100 % with koopman (median travel over people: 0.50 mm" in text
    assert "±" not in text
    assert text.index('<section id="found"') < text.index('<section id="overview"')
    assert "T1: energy is left out, as its force_error differs from that of penalty in no" in text
    # the needle is a task of this study, milling is not
    assert "pushed by a rising force" in text and "The tool of T3" not in text
    tests = {(row["task"], row["question"]): row for row in rows_of(page.parent / "tests.csv")}
    assert tests["T1", "force_error: method"]["shows"] == "effect"
    assert tests["T2", "ratio_error: group"]["shows"] == "none shown"
    assert tests["T1", "force_error: method"]["test"] == "sign flips"
    assert tests["all", "position_error_mm: group"]["other tests"].startswith("mixed model p")
    rates = {
        (row["task"], row["question"], row["test"]): row
        for row in rows_of(page.parent / "power.csv")
    }
    # three standard errors of 2,000 populations about 5 %, and one point for the smoothed residuals
    assert 2.5 < float(rates["T2", "method", "sign flips"]["type I %"]) < 7.5
    assert ("T1", "group, 3 metrics", "sign flips") in rates
    means = [row for row in rows_of(page.parent / "index.csv") if row["what"] == "mean"]
    assert max(means, key=lambda row: float(row["value"]))["name"].startswith("koopman")


def rows_of(path: Path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def compared(section):
    """Return the first two entries of the rows that are compared with the paper."""
    return {tuple(row.values())[:2] for row in section.table if "against paper" in row}


def test_figures_are_compared_only_where_the_task_is_that_of_the_paper(study, monkeypatch):
    """Needle and drilling differ from the paper's tasks, and a task that differs has no figure."""
    table = study.table("T1", "T2").complete()
    printed = {(task, method) for task in ("T1", "T2") for method in PRINTED}
    assert compared(force_section(table)) == printed
    assert compared(task_section(table)) == {("T1", "all"), ("T2", "all")}
    cases = {each.name: each for each in case_sections(study, 0)}
    assert compared(cases["case-reaming"])
    for name in ("case-needle", "case-drilling"):
        assert not compared(cases[name])
        assert "No figure here is compared with the paper's: " in " ".join(cases[name].sentences)
    count = len(printed) + 2
    found = found_section([force_section(table), task_section(table)])
    assert f" of {count}. Agreement means" in found.sentences[-1]
    monkeypatch.setitem(TASKS, "T2", replace(TASKS["T2"], known_difference="another wall"))
    found = found_section([force_section(table), task_section(table)])
    assert f" of {count // 2}. Agreement means" in found.sentences[-1]


def test_intervals_of_positive_metrics_are_positive():
    """One person with a large error makes the symmetric interval end below zero."""
    errors = np.array([0.01, 0.02, 0.03, 0.90])
    assert mean_interval(errors).low < 0.0
    mean, low, high = signed_interval(errors)
    assert mean == pytest.approx(errors.mean()) and 0.0 < low < mean < high
    assert signed_interval(-errors) == pytest.approx((-mean, -high, -low))
    # values of both signs have the symmetric interval
    both = np.array([-1.0, 2.0, 0.5])
    assert signed_interval(both) == mean_interval(both)
    assert signed_interval(np.array([0.3])) == (0.3, 0.3, 0.3)


def test_intervals_of_positive_metrics_hold_the_mean_at_their_rate():
    """Coverage over 4,000 samples of ten log-normal values."""
    spread = 0.5
    values = np.exp(spread * np.random.default_rng(0).standard_normal((4000, 10)))
    ends = np.array([signed_interval(each)[1:] for each in values])
    mean = np.exp(0.5 * spread**2)
    inside = (ends[:, 0] <= mean) & (mean <= ends[:, 1])
    # the mean of ten skewed values is not normal: 93.7 % at a spread of 0.5
    assert inside.mean() == pytest.approx(0.95, abs=0.02)


def test_errors_of_predictors_have_positive_intervals():
    """A chart with a logarithmic axis cannot show an interval that ends below zero."""
    errors = np.outer([0.01, 0.02, 0.03, 0.90], np.ones(len(HORIZONS)))
    found = PredictorComparison("wall", {"hold": errors}, {})
    mean, low, high = found.at("hold", 4)
    assert mean == pytest.approx(0.24) and 0.0 < low < mean < high


def test_a_study_that_has_hardly_begun_is_reported(tmp_path):
    """One trial of one group: its figures, and why nothing could be tested."""
    folder = StudyFolder(tmp_path / "study")
    folder.begin(PLAN)
    key = TrialKey("T2", "novice", 0)
    folder.write(Trial(key, 1, tuple(planted(key, np.random.default_rng(0))), 1.0))
    sections = {each.name: each for each in sections_of(folder)}
    overview = " ".join(sections["overview"].sentences)
    assert "There is no trial of intermediate or expert yet" in overview
    assert "could not be tested" in " ".join(sections["tests"].sentences)
    assert "force" in sections and "case-needle" not in sections


@pytest.mark.slow
@pytest.mark.parametrize("trials", [1, 2])
@pytest.mark.parametrize("groups", [("expert",), ("novice", "expert")])
@pytest.mark.parametrize("methods", [("penalty",), ("penalty", "kalman")])
def test_a_study_of_few_people_is_reported(trials, groups, methods, tmp_path):
    """Each section states why it has no result; no figure is computed from a lack of variation."""
    plan = Plan(trials=trials, tasks=("T2",), groups=groups, methods=methods)
    folder = StudyFolder(tmp_path / "study")
    folder.begin(plan)
    for number, key in enumerate(plan.all_trials()):
        rng = np.random.default_rng(number)
        rows = [
            row | {"method": method, "position_error_mm": rng.random()}
            for method, row in zip(methods, planted(key, rng), strict=False)
        ]
        folder.write(Trial(key, number, tuple(rows), 1.0))
    sections = {each.name: each for each in sections_of(folder)}
    assert f"A group has at most {trials} simulated user" in " ".join(
        sections["overview"].sentences
    )
    text = " ".join(sections["index"].sentences)
    assert "-0.00" not in text
    if trials == 1 or len(groups) == 1:
        assert text.startswith("This could not be tested") and not sections["index"].rows
    if len(methods) == 1:
        assert "the order is" not in text


def test_distances_from_a_path():
    """Distances from a path are exact for points next to, beyond and on it.

    The path has two legs at a right angle.
    """
    path = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0]])
    tips = np.array([[5.0, 3, 0], [13, 0, 4], [10, 4, 0], [-3, 0, 4]])
    assert path_distance(tips, path) == pytest.approx([3.0, 5.0, 0.0, 5.0])
