"""`tissue calibrate`: sessions, their logs, interruptions, answers of people, and what is refused."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.evaluation.calibration.intervals import Person, StoppedError, play
from tissue.evaluation.calibration.run_session import questioner, simulated_answers, simulated_observer
from tissue.evaluation.calibration.session import Comparison, Magnitude, Plan, Session
from tissue.evaluation.calibration.trial_log import TrialLog, read_log
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import MouseDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.perception.observer import read_observer

ROOT = Path(__file__).resolve().parents[3]
SHORT = Plan(trials=20, numbers=6)


def answered(plan, answers, path=None):
    """A session of a plan, answered to its end."""
    log = TrialLog(path, "somebody", plan) if path else None
    session = log.session if log else Session(plan)
    while not session.complete:
        asked = session.ask()
        (log or session).take(asked, answers(asked, session.trial))
    if log:
        log.close()
    return session


@pytest.fixture
def log(tmp_path):
    """A complete log."""
    path = tmp_path / "a.trials.jsonl"
    answered(SHORT, questioner("simulated:1", "mouse", seed=0, read=input, show=print)[0], path)
    return path


def test_a_session_ends_with_observer_trials_and_picture(command, here):
    code, out, error = command("calibrate", "--observer", "simulated:4", "--out", "sub/one.json")
    assert (code, error) == (0, "")
    assert "Weber fraction" in out and "Stevens' exponent" in out
    assert sorted(os.listdir(here / "sub")) == ["one.json", "one.png", "one.trials.jsonl"]
    assert (here / "sub" / "one.png").stat().st_size > 10_000
    truth, _ = simulated_observer("simulated:4")
    found = read_observer(here / "sub" / "one.json")
    assert found.trials == 144
    # four standard deviations of this one session's own posterior
    assert abs(np.log(found.kappa / truth.kappa[0])) < 4.0 * found.covariance[2, 2] ** 0.5
    assert abs(found.beta - truth.beta[0]) < 4.0 * found.covariance[1, 1] ** 0.5
    code, _, error = command("calibrate", "--observer", "simulated:4", "--out", "sub/one.json")
    assert code == 2 and "out must not exist yet" in error
    before = (here / "sub" / "one.json").read_bytes()
    assert command("calibrate", "--observer", "simulated:4", "--out", "sub/one.json", "--overwrite")[0] == 0
    assert (here / "sub" / "one.json").read_bytes() == before
    (here / "sub" / "one.json").unlink()  # as if stopped before it was written
    assert command("calibrate", "--observer", "simulated:4", "--out", "sub/one.json")[0] == 0
    assert (here / "sub" / "one.json").read_bytes() == before


def test_a_picture_that_is_there_is_kept(refused, here):
    (here / "mine.png").write_text("mine")
    message = refused("calibrate", "--observer", "simulated:4", "--out", "mine.json")
    assert "got mine.png: pass --overwrite or choose another --out" in message
    assert os.listdir(here) == ["mine.png"] and (here / "mine.png").read_text() == "mine"


def test_a_session_goes_on_at_any_trial(tmp_path, log):
    """Cut after every line, and within one, the session ends with the same bits."""
    answers, whole = questioner("simulated:1", "mouse", seed=0, read=input, show=print)[0], log.read_bytes()
    _, straight = read_log(log)
    lines = whole.splitlines(keepends=True)
    for kept in range(len(lines) + 1):
        for extra in (b"", (lines[kept][:-1] if kept < len(lines) else b"")):
            path = tmp_path / "cut.trials.jsonl"
            path.write_bytes(b"".join(lines[:kept]) + extra)
            again = TrialLog(path, "somebody", SHORT)
            assert again.mended == bool(extra) and again.session.trial == max(kept - 1, 0)
            again.close()
            session = answered(SHORT, answers, path)
            assert path.read_bytes() == whole
            assert (session.threshold.posterior == straight.threshold.posterior).all()
            path.unlink()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"], ids=["ctrl-c", "kill"])
def test_a_stopped_command_goes_on(tmp_path, name):
    def run(out, **options):
        arguments = ["calibrate", "--observer", "simulated:2", "--trials", "600", "--numbers", "4", "--out", str(out)]
        code = "from tissue.cli.main import main; main()"
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
        )  # fmt: skip

    out, path = tmp_path / "stopped.json", tmp_path / "stopped.trials.jsonl"
    first = run(out)
    while not path.exists() or path.read_bytes().count(b"\n") < 10:
        assert first.poll() is None, first.stderr.read()
        time.sleep(0.001)
    first.send_signal(getattr(signal, name))
    _, message = first.communicate(timeout=60)
    done = path.read_bytes().count(b"\n") - 1
    assert 9 <= done < 604 and not out.exists()
    if name == "SIGINT":
        assert first.returncode == 130 and f"stopped after trial {done}" in message
    second = run(out)
    _, message = second.communicate(timeout=120)
    assert second.returncode == 0 and f"going on at trial {done + 1}" in message
    session = answered(
        Plan(trials=600, numbers=4), questioner("simulated:2", "mouse", seed=0, read=input, show=print)[0]
    )
    _, restored = read_log(path)
    assert restored.asked == session.asked and restored.given == session.given
    np.testing.assert_array_equal(read_observer(out).mean, session.observer("x").mean)


def change(lines, number, **entries):
    """Lines of a log with entries of one replaced."""
    entry = json.loads(lines[number]) | entries
    return [*lines[:number], json.dumps(entry), *lines[number + 1 :]]


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b""], ids=["no text", "empty"])
def test_a_log_that_is_no_text_is_refused_without_the_words_of_a_decoder(tmp_path, content):
    path = tmp_path / "log.jsonl"
    path.write_bytes(content)
    with pytest.raises(InputError, match="log must be a file of trials, got ") as refused:
        read_log(path)
    assert "codec" not in str(refused.value)


@pytest.mark.parametrize(
    ("mend", "message"),
    [
        (lambda lines: change(lines, 3, answer=3), "answer must be 1 or 2, got 3"),
        (lambda lines: change(lines, 3, answer="one"), "answer must be a number, got 'one'"),
        (lambda lines: change(lines, 3, answer=True), "answer must be a number, got True"),
        (lambda lines: change(lines, 24, answer=-2.0), "answer must be a number above 0, got -2"),
        (lambda lines: change(lines, 3, base_N=-0.3), "trial must be one of the plan's"),
        (lambda lines: change(lines, 24, force_N=-0.3), "trial must be one of the plan's"),
        (lambda lines: [*lines[:3], *lines[4:]], "trial must be 2, got 3"),
        (lambda lines: [*lines[:4], *lines[3:]], "trial must be 3, got 2"),
        (lambda lines: [*lines[:3], "x", *lines[4:]], "in line 4 of"),
        (lambda lines: [*lines[:3], "[]", *lines[4:]], "in line 4 of"),
        (lambda lines: change(lines, 0, version=9), "log must be of format 1 or older, got 9, written by tissue"),
        (lambda lines: change(lines, 0, format="other"), "which is something else"),
        (lambda lines: change(lines, 0, plan={}), "log must begin with a plan"),
        (lambda lines: change(lines, 0, observer="other"), "got observer other instead of somebody"),
        (lambda lines: ["time,force", "0,1"], "which is something else"),
    ],
    ids=["three", "word", "true", "negative", "foreign", "force", "gap", "twice", "text", "list", "version", "format", "plan",
         "observer", "table"],
)  # fmt: skip
def test_a_log_that_cannot_be_gone_on_with_is_refused_and_kept(log, mend, message):
    log.write_text("\n".join(mend(log.read_text().splitlines())) + "\n")
    before = log.read_bytes()
    with pytest.raises(InputError) as refused:
        TrialLog(log, "somebody", SHORT)
    assert message in str(refused.value)
    assert log.read_bytes() == before


def test_another_plan_is_another_session(log):
    with pytest.raises(InputError, match="got trials 20 instead of 30"):
        TrialLog(log, "somebody", Plan(trials=30, numbers=6))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "one of --observer, --ask and --population must be given"),
        (("--observer", "simulated:1", "--ask"), "one of --observer, --ask and --population must be given"),
        (("--observer", "me"), "observer must be simulated:SEED"),
        (("--observer", "simulated:master:1"), "observer must be simulated:SEED"),
        (("--observer", "simulated:-1"), "observer must be simulated:SEED"),
        (("--observer", "simulated:1", "--trials", "-1"), "trials must be in [0, 100000], got -1"),
        (("--observer", "simulated:1", "--seed", "-1"), "seed must be in"),
        (("--observer", "simulated:1", "--trials", "0", "--numbers", "0"), "trials and numbers must not both be 0"),
        (("--ask", "--device", "phantom"), "device must be one of mouse, touch, omni, six-dof, got phantom"),
        (("--population", "nowhere"), "population must be a folder of sessions, got nowhere"),
        (("--population", "."), "population must hold three sessions or more"),
        (("--observer", "simulated:1", "--out", "."), "out must be the name of a file that ends in .json, got ."),
        (
            ("--observer", "simulated:1", "--out", "a.png"),
            "out must be the name of a file that ends in .json, got a.png",
        ),
        (("--population", ".", "--out", "a"), "out must be the name of a file that ends in .json, got a"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(refused, here, arguments, sentence):
    assert sentence in refused("calibrate", *arguments)
    assert not os.listdir(here)


def simulated(seed, prior=None, **plan):
    people, observer_seed = simulated_observer(f"simulated:{seed}")
    given = {"prior": prior} if prior else {}
    return answered(Plan(**plan, **given), simulated_answers(people, observer_seed))


def test_an_ordinary_session_has_no_notes():
    for seed in range(5):
        assert simulated(seed, trials=60, numbers=6).notes() == []


def answer_with(share):
    """Answers of which a share is right whatever is asked; a number in proportion to the force."""
    rng = np.random.default_rng(1)
    return lambda asked, _: (
        asked.force_N if isinstance(asked, Magnitude) else asked.greater if rng.random() < share else 3 - asked.greater
    )


def test_all_right_only_bounds_the_threshold():
    session = answered(Plan(trials=60, numbers=2), answer_with(1.0))
    assert any("all 60 comparisons were right" in note and "from above alone" in note for note in session.notes())
    assert any("lies at the prior's lowest Weber fraction" in note for note in session.notes())
    assert session.observer("x").kappa > 0.0


def test_guesses_and_mixed_up_answers_are_reported():
    assert any("no more than by guessing" in note for note in answered(Plan(trials=60), answer_with(0.5)).notes())
    mixed = answered(Plan(trials=60), answer_with(0.0)).notes()
    assert any("were 1 and 2 mixed up" in note for note in mixed)
    assert any("the prior excludes the data" in note for note in mixed)


@pytest.mark.parametrize(("lowest", "highest", "side"), [(0.3, 0.6, "lowest"), (0.005, 0.02, "highest")])
def test_a_prior_that_excludes_the_truth_is_reported(lowest, highest, side):
    from tissue.perception.adaptive import ThresholdPrior

    prior = ThresholdPrior(lowest=lowest, highest=highest)
    assert any(
        f"the prior's {side} Weber fraction" in note for note in simulated(1, prior, trials=200, numbers=6).notes()
    )


def test_no_numbers_leave_the_exponent_to_the_prior():
    session = answered(Plan(trials=5, numbers=0), answer_with(1.0))
    assert any("Stevens' exponent is the prior's" in note for note in session.notes())
    assert session.observer("x").beta == pytest.approx(1.4)


class Recorder(MouseDevice):
    """A device that keeps the commands it is to play."""

    def __init__(self):
        super().__init__()
        self.played = []

    def command(self, force_N, torque_Nm):
        self.played.append(np.array(force_N))


def person(words, device=None):
    """A person who types some words, with a clock of her own; and what she is shown."""
    now, shown, words = [0.0], [], iter(words)

    def wait(seconds):
        now[0] += seconds

    def read():
        try:
            return next(words)
        except StopIteration:
            raise EOFError from None

    return Person(
        device or Recorder(), read=read, show=shown.append, bars_N=3.3, clock=lambda: now[0], wait=wait
    ), shown


def test_a_person_feels_both_intervals_and_is_asked_until_the_answer_is_possible():
    device = Recorder()
    asked = Comparison(1.0, 0.5, greater=2)
    who, shown = person(["", "3", "one", "-1", "r", "2"], device)
    assert who.answer(asked) == 2
    assert sum("answer must be 1 or 2, got" in line for line in shown) == 4
    assert [line for line in shown if line.startswith("interval 1")] and len(device.played) > 2000
    down = -np.array(device.played)[:, 2]
    assert down.max() == pytest.approx(1.5) and (down >= 0.0).all() and down[-1] == 0.0
    first = down[: len(down) // 4]
    assert first.max() == pytest.approx(1.0)
    who, shown = person(["nan", "-3", "inf", "0", "2,5"])
    assert who.answer(Magnitude(1.0)) == 2.5
    assert sum("answer must be a number above 0" in line for line in shown) == 4
    for words in (["q"], []):
        with pytest.raises(StoppedError):
            person(words)[0].answer(asked)


def test_a_simulated_device_plays_in_its_own_time():
    """A clock that has run for a day is not simulated from its start."""
    device = SimulatedDevice(device_parameters("six-dof"))
    now, words = [86_400.0], iter(["1"])

    def wait(seconds):
        now[0] += seconds

    who = Person(device, read=lambda: next(words), show=lambda _: None, clock=lambda: now[0], wait=wait)
    assert who.answer(Comparison(1.0, 0.5, greater=2)) == 1
    assert device.read(3.0).time_s < 4.0 and device.translation.position[2] < 0.0


def test_an_interrupted_interval_leaves_no_force():
    device = Recorder()

    def wait(_):
        if len(device.played) == 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        play(device, 2.0, clock=lambda: 1e-3 * len(device.played), wait=wait)
    assert (device.played[-1] == 0.0).all() and np.linalg.norm(device.played[-2]) > 1.0


def test_a_person_at_the_keyboard_may_stop_and_go_on(command, here, monkeypatch):
    """Answers from standard input; the end of it stops the session, and the same command goes on."""
    monkeypatch.setitem(play.__kwdefaults__, "length_s", 0.01)
    monkeypatch.setattr("tissue.evaluation.calibration.intervals.PAUSE_S", 0.0)

    def go(*words):
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{word}\n" for word in words)))
        return command("calibrate", "--ask", "--trials", "4", "--numbers", "2")

    code, out, error = go("1", "7", "2")
    assert code == 130 and "stopped after trial 2" in error
    assert "answer must be 1 or 2, got 7" in out and "█" in out
    code, _, error = go("1", "1", "5", "much", "10")
    assert code == 0 and "going on at trial 3" in error
    assert read_observer(here / "observer.json").trials == 6


def test_the_posterior_is_shown_as_text():
    from rich.console import Console

    from tissue.evaluation.calibration.posterior_view import posterior_panel

    shown = Console(width=100, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    shown.print(posterior_panel(simulated(1, trials=60, numbers=6)))
    text = shown.export_text()
    assert "trial 66 of 66" in text and "█" in text and "10" in text and "95 % within" in text
