"""`tissue calibrate`: sessions, their logs and interruptions, and what is refused."""

import json
import os

import numpy as np
import pytest
from calibration_sessions import answered

from meshes.base.errors import InputError
from tissue.evaluation.calibration.answers import simulated_answers, simulated_observer
from tissue.evaluation.calibration.session import Plan, TrialLog, read_log
from tissue.perception.observer import read_observer

SHORT = Plan(trials=20, numbers=6)


@pytest.fixture
def log(tmp_path):
    """A complete log."""
    path = tmp_path / "a.trials.jsonl"
    answered(SHORT, simulated_answers(*simulated_observer("simulated:1")), path)
    return path


def test_a_session_ends_with_observer_trials_and_picture(command, here):
    asked = ["calibrate", "--observer", "simulated:4", "--out", "sub/one.json"]
    asked += ["--trials", "40", "--numbers", "8"]
    code, out, error = command(*asked)
    assert (code, error) == (0, "")
    assert "Weber fraction" in out and "Stevens' exponent" in out
    assert sorted(os.listdir(here / "sub")) == ["one.json", "one.png", "one.trials.jsonl"]
    assert (here / "sub" / "one.png").stat().st_size > 10_000
    truth, _ = simulated_observer("simulated:4")
    found = read_observer(here / "sub" / "one.json")
    assert found.trials == 48
    # terminal and file give the same numbers
    plain = json.loads((here / "sub" / "one.json").read_text("utf-8"))
    assert f"threshold at {plain['threshold_at_N']:g} N {plain['threshold_N']:.3f} N" in out
    assert f"Weber fraction {100 * plain['weber_fraction']:.1f} %" in out
    assert f"exponent {plain['exponent']:.2f}" in out
    # four standard deviations of this one session's own posterior
    assert abs(np.log(found.kappa / truth.kappa[0])) < 4.0 * found.covariance[2, 2] ** 0.5
    assert abs(found.beta - truth.beta[0]) < 4.0 * found.covariance[1, 1] ** 0.5
    code, _, error = command(*asked)
    assert code == 2 and "out must not exist yet" in error
    before = (here / "sub" / "one.json").read_bytes()
    assert command(*asked, "--overwrite")[0] == 0
    assert (here / "sub" / "one.json").read_bytes() == before
    for name in ("one.json", "one.png"):  # as if stopped before they were written
        (here / "sub" / name).unlink()
    assert command(*asked)[0] == 0
    assert (here / "sub" / "one.json").read_bytes() == before


def test_a_session_goes_on_at_any_trial(tmp_path, log):
    """Cut after every third line, and within one, the session ends with the same bits."""
    answers, whole = (
        simulated_answers(*simulated_observer("simulated:1")),
        log.read_bytes(),
    )
    _, straight = read_log(log)
    lines = whole.splitlines(keepends=True)
    for kept in [*range(0, len(lines), 3), len(lines)]:
        for extra in (b"", (lines[kept][:-1] if kept < len(lines) else b"")):
            path = tmp_path / "cut.trials.jsonl"
            path.write_bytes(b"".join(lines[:kept]) + extra)
            again = TrialLog(path, "somebody", SHORT)
            assert again.repaired == bool(extra) and again.session.trial == max(kept - 1, 0)
            again.close()
            session = answered(SHORT, answers, path)
            assert path.read_bytes() == whole
            assert (session.threshold.posterior == straight.threshold.posterior).all()
            path.unlink()


def change(lines, number, **entries):
    """Lines of a log with entries of one replaced."""
    entry = json.loads(lines[number]) | entries
    return [*lines[:number], json.dumps(entry), *lines[number + 1 :]]


@pytest.mark.parametrize(
    ("damaged", "message"),
    [
        (lambda lines: change(lines, 3, answer=3), "answer must be 1 or 2, got 3"),
        (lambda lines: change(lines, 3, answer="one"), "answer must be a number, got 'one'"),
        (lambda lines: change(lines, 3, answer=True), "answer must be a number, got True"),
        (lambda lines: change(lines, 24, answer=-2.0), "answer must be a number above 0, got -2"),
        (lambda lines: change(lines, 3, base_N=-0.3), "trial must belong to the plan"),
        (lambda lines: change(lines, 24, force_N=-0.3), "trial must belong to the plan"),
        (lambda lines: [*lines[:3], *lines[4:]], "trial must be 2, got 3"),
        (lambda lines: [*lines[:4], *lines[3:]], "trial must be 3, got 2"),
        (lambda lines: [*lines[:3], "x", *lines[4:]], "with an error in line 4 (no trial). "),
        (lambda lines: [*lines[:3], "[]", *lines[4:]], "with an error in line 4 (no trial). "),
        (
            lambda lines: change(lines, 0, version=9),
            "log must have format 1 or older, got format 9 in ",
        ),
        (lambda lines: change(lines, 0, format="other"), "with other content"),
        (lambda lines: change(lines, 0, plan={}), "log must contain a plan in its first line"),
        (
            lambda lines: change(lines, 0, observer="other"),
            "got a session of the observer other in ",
        ),
        (lambda lines: ["time,force", "0,1"], "with other content"),
    ],
    ids=[
        "three",
        "word",
        "true",
        "negative",
        "foreign",
        "force",
        "gap",
        "twice",
        "text",
        "list",
        "version",
        "format",
        "plan",
        "observer",
        "table",
    ],
)
def test_a_log_that_cannot_be_gone_on_with_is_refused_and_kept(log, damaged, message):
    log.write_text("\n".join(damaged(log.read_text().splitlines())) + "\n")
    before = log.read_bytes()
    with pytest.raises(InputError) as refused:
        TrialLog(log, "somebody", SHORT)
    assert message in str(refused.value)
    assert log.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "one of --observer, --ask and --population must be given"),
        (
            ("--observer", "simulated:1", "--ask"),
            "one of --observer, --ask and --population must be given",
        ),
        (("--observer", "me"), "observer must be simulated:SEED"),
        (("--observer", "simulated:master:1"), "observer must be simulated:SEED"),
        (("--observer", "simulated:-1"), "observer must be simulated:SEED"),
        (("--observer", "simulated:1", "--trials", "-1"), "trials must be in [0, 100000], got -1"),
        (("--observer", "simulated:1", "--seed", "-1"), "seed must be in"),
        (
            ("--observer", "simulated:1", "--trials", "0", "--numbers", "0"),
            "trials and numbers must not both be 0",
        ),
        (
            ("--ask", "--device", "phantom"),
            (
                "device must be one of mouse, touch, omni, six-dof, haply, forcedimension, "
                "sigma-7, openhaptics, network, recorded, got phantom"
            ),
        ),
        (
            ("--population", "nowhere"),
            "population must be an existing folder of sessions, got nowhere",
        ),
        (("--population", "."), "population must contain at least three sessions"),
        (("--observer", "simulated:1", "--out", "."), "out must be a file, got the folder ."),
        (
            ("--observer", "simulated:1", "--out", "a.png"),
            "out must end in .json, got a.png",
        ),
        (
            ("--population", ".", "--out", "a"),
            "out must end in .json, got a. ",
        ),
    ],
)
def test_what_cannot_be_calibrated_is_refused(refused, here, arguments, sentence):
    assert sentence in refused("calibrate", *arguments)
    assert not os.listdir(here)
