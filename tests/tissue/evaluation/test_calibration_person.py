"""A person who is calibrated: intervals that are played, and answers that are typed."""

import io
import json

import numpy as np
import pytest
from haply_service import HaplyService

from tissue.evaluation.calibration.answers import Person, StoppedError, play
from tissue.evaluation.calibration.session import Comparison, Magnitude
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import MouseDevice
from tissue.perception.observer import read_observer

LIMITS = device_parameters("touch")


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
        device or Recorder(),
        limits=LIMITS,
        read=read,
        show=shown.append,
        clock=lambda: now[0],
        wait=wait,
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


def test_an_interrupted_interval_leaves_no_force():
    device = Recorder()

    def wait(_):
        if len(device.played) == 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        play(device, 2.0, limits=LIMITS, clock=lambda: 1e-3 * len(device.played), wait=wait)
    assert (device.played[-1] == 0.0).all() and np.linalg.norm(device.played[149]) > 1.0
    assert not any(force.any() for force in device.played[150:])


def test_a_person_at_the_keyboard_may_stop_and_go_on(command, here, monkeypatch):
    """A person at the keyboard may stop and continue.

    Answers come from standard input; its end stops the session, and the same command continues.
    """
    monkeypatch.setattr("tissue.evaluation.calibration.answers.LENGTH_S", 0.01)
    monkeypatch.setattr("tissue.evaluation.calibration.answers.PAUSE_S", 0.0)

    def go(*words):
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{word}\n" for word in words)))
        return command("calibrate", "--ask", "--trials", "4", "--numbers", "2")

    code, out, error = go("1", "7", "2")
    assert code == 130 and "stopped after trial 2" in error
    assert "answer must be 1 or 2, got 7" in out and "█" in out
    code, _, error = go("1", "1", "5", "much", "10")
    assert code == 0 and "continuing at trial 3" in error
    assert read_observer(here / "observer.json").trials == 6


def test_a_real_device_pushes_down_in_the_intervals_alone(command, here, monkeypatch):
    monkeypatch.setitem(play.__kwdefaults__, "length_s", 0.3)
    monkeypatch.setattr("tissue.evaluation.calibration.answers.PAUSE_S", 0.05)
    monkeypatch.setattr("sys.stdin", io.StringIO("1\n2\n5\n"))
    with HaplyService() as service:
        code, out, error = command(
            *("calibrate", "--ask", "--device", "haply", "--address", service.url),
            *("--trials", "2", "--numbers", "1", "--out", "felt.json"),
        )
        assert code == 0 and error.startswith("note: fewer than two forces") and "█" not in out
        assert "pushes down with at most 10 N" in out
        forces = np.array([force for _, _, force in service.commands])
    assert (forces[:, :2] == 0.0).all() and (forces[:, 2] <= 0.0).all()
    assert not forces[-1].any()
    # five intervals, each from zero to its force and back
    pushing = forces[:, 2] < -0.02
    assert np.count_nonzero(np.diff(pushing.astype(int)) == 1) == 5
    with (here / "felt.trials.jsonl").open() as log:
        asked = [json.loads(line) for line in log][1:]
    most = max(max(each.get("force_N", 0.0), each.get("base_N", 0.0)) for each in asked)
    assert -forces[:, 2].min() >= 0.9 * most > 0.0


def test_a_device_without_valid_samples_ends_the_session(command, here, monkeypatch):
    """No force is played on it, and an answer would be about nothing."""
    monkeypatch.setattr("sys.stdin", io.StringIO("1\n2\n5\n"))
    monkeypatch.setitem(play.__kwdefaults__, "length_s", 0.3)
    with HaplyService() as service:
        service.dropped = 1.0
        code, _, error = command(
            *("calibrate", "--ask", "--device", "haply", "--address", service.url)
        )
    assert code == 2 and error.count("\n") == 1, error
    assert not any(any(force) for _, _, force in service.commands)


def test_an_address_without_a_real_device_is_refused(command):
    for device in ("touch", "mouse"):
        code, _, error = command("calibrate", "--ask", "--device", device, "--address", "COM3")
        assert code == 2 and "--address" in error
