"""The first section of a report: five sentences from the data, three pictures, and what is missing named."""

import numpy as np
import pytest

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.found import found_section
from tissue.evaluation.study.found_pictures import MARKS
from tissue.evaluation.study.section import COLOURS, Section
from tissue.evaluation.study.tasks import METHODS

METRICS = {"force_error": 0.08, "least_error": 0.02, "latency_ms": 4.0}


def table(metrics, tasks=("T1", "T2"), left=0.5):
    """Two people a group; Koopman's methods have a share of every metric of the others."""
    return TrialTable.from_rows(
        {"task": task, "group": group, "user": str(user), "trial": user, "seed": 1, "method": method}
        | {name: value * (left if method.startswith("koopman") else 1.0) for name, value in metrics.items()}
        for task in tasks
        for group in ("novice", "expert")
        for user in range(2)
        for method in METHODS
    )


def discrimination():
    rows = tuple(("capsule", "novice", method, "2.20" if "perception" in method else "2.00") for method in METHODS)
    return Section("discrimination", "Discrimination", (), ("what", "group", "method", "d′"), rows)


def force(*judged):
    header = ("task", "method", "force error / %", "paper %", "against paper")
    return Section("force", "Force fidelity", (), header, tuple(("T1", "penalty", "", "", each) for each in judged))


def test_five_sentences_and_three_pictures_are_made_of_the_data():
    needle = table({"excess_mm": 1.2, "noticed": 1.0}, ("needle",), left=0.75)
    sections = [discrimination(), force("agrees", "", "0.50 of it"), Section("registration", "", ("registered",))]
    found = found_section(table(METRICS), needle, sections)
    assert len(found.sentences) == 5 and all(each.count(". ") == 0 and each.endswith(".") for each in found.sentences)
    error, latency, sensed, overshoot, against = found.sentences
    assert "under penalty is T1 8.0 % (2.0 %), T2 8.0 % (2.0 %), in brackets" in error
    assert "the others leave energy 1.00, 1.00; koopman 0.50, 0.50; " in error
    assert "in T1, T2, penalty +4.0, +4.0; energy +4.0, +4.0; koopman +2.0, +2.0; " in latency
    assert "under koopman, a d′ of capsule 2.00, and changes" in sensed
    assert "under penalty +0; energy +0; " in sensed and "koopman-perception +10, where the paper" in sensed
    assert "penalty 1.20 mm (100 % noticed)" in overshoot and "prediction changes it by -25 %" in overshoot
    assert against == (
        "Of 2 figures held against the paper 1 do not agree: force fidelity T1 penalty 0.50 of it; nothing differs "
        "from the plan."
    )
    assert len(found.pictures) == 3 and all(png.startswith(b"\x89PNG") for _, png in found.pictures)


def test_what_is_missing_is_named():
    found = found_section(None, None, [])
    assert [each.split(",")[0] for each in found.sentences] == [
        "No force error was measured",
        "No residual latency was measured",
        "No discrimination was measured",
        "No overshoot after a puncture was measured",
        "Nothing could be held against the paper's figures.",
    ]
    assert not found.pictures
    without = found_section(table({"force_error": 0.08}), None, [force("agrees")])
    assert "T2 8.0 %, the least error was not measured, of which the others leave energy 1.00" in without.sentences[0]
    assert without.sentences[1].startswith("No residual latency") and len(without.pictures) == 1
    assert without.sentences[4] == "All 1 figures held against the paper agree with it."


def test_without_the_penalty_law_errors_are_given_themselves_in_percent():
    others = table(METRICS).where(method=["energy", "koopman"])
    assert found_section(others, None, []).sentences[0] == (
        "The force error at the motor is, in T1, T2, energy 8.0%, 8.0%; koopman 4.0%, 4.0%."
    )


def test_the_index_stands_in_for_the_overshoot():
    rows = (("weight", "force_error", "0.5", "0.4", "0.6", ""), ("mean", "penalty", "-0.2", "-0.3", "-0.1", ""))
    found = found_section(None, None, [Section("index", "Composite index", (), (), rows)])
    assert [what for what, _ in found.pictures] == ["composite index"]


def test_a_study_without_a_plan_and_one_that_differs_are_named():
    for registration, words in (
        (Section("registration", "", ("No plan was registered before.",)), "no plan was registered before the trials."),
        (Section("registration", "", ("x",), ("kind",), (("a",), ("b",))), "2 differences from the registered plan"),
    ):
        assert words in found_section(None, None, [registration]).sentences[4]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_a_mark_and_a_colour(method):
    """A person without colour vision needs the marks alone."""
    assert method in COLOURS and list(MARKS.values()).count(MARKS[method]) == 1
    assert np.isfinite(int(COLOURS[method][1:], 16))
