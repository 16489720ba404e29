"""Remaining time of a command."""

import pytest

from tissue.system import progress
from tissue.system.progress import Remaining, duration_text


def test_the_remaining_time_follows_the_pace(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(progress, "perf_counter", lambda: now_s[0])
    remaining = Remaining()
    # a continued command begins at a fifth
    assert remaining.text(0.2) == ""
    now_s[0] = 600.0
    assert remaining.text(0.21) == ""
    assert remaining.text(0.4) == ", 30 min left"
    now_s[0] = 601.0
    assert remaining.text(0.999) == ""
    # a second stage begins anew, also above the begin of the first one
    assert remaining.text(0.3) == ""
    now_s[0] = 701.0
    assert remaining.text(0.5) == ", 4 min left"


@pytest.mark.parametrize(
    ("seconds", "text"), [(20.0, "less than 1 min"), (1500.0, "25 min"), (7200.0, "2.0 h")]
)
def test_a_time_is_written_in_words(seconds, text):
    assert duration_text(seconds) == text


def test_a_line_without_a_terminal_holds_share_and_remaining_time(monkeypatch, capsys):
    now_s = [0.0]
    monkeypatch.setattr(progress, "perf_counter", lambda: now_s[0])
    with progress.progress(quiet_s=30.0) as report:
        report("run 1 of 4", 0.0)
        now_s[0] = 60.0
        report("run 2 of 4", 0.25)
    assert capsys.readouterr().err == "run 2 of 4, 3 min left, 25 %\n"
