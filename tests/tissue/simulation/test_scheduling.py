"""Choices for a run and lateness of the machine, in the summary and in the printed table."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from kernels.launcher import LaunchCounts
from tissue import load_scene, simulate
from tissue.cli import run as command
from tissue.models.tissue_model import FreeSpace
from tissue.simulation import loop
from tissue.simulation.loop import SPUN_S, SPUN_SHARE, Scheduling, spin_time_s
from tissue.system.machine_gaps import MachineGaps


class Background(FreeSpace):
    """Tissue that works in the background, next to the ticks."""

    scheduling = "stress: idle priority"


@pytest.fixture(scope="module")
def run():
    return simulate(load_scene("wall", {"duration_s": 0.05}))


@pytest.fixture
def chosen(monkeypatch):
    """Return the choices of a run with 40 large launches, 30 of them split.

    The machine has five gaps in half a second.
    """
    counts = iter([LaunchCounts(7, 5), LaunchCounts(47, 35)])
    monkeypatch.setattr(loop, "launch_counts", lambda: next(counts))
    looks = iter([MachineGaps(0.25, (1e-3, 4e-3)), MachineGaps(0.25, (3e-4,) * 3)])
    monkeypatch.setattr(loop, "spin", lambda seconds: next(looks))
    found = Scheduling(Background(), cores=2, spin_s=0.25)
    found.end()
    found.look_again()
    return found


def test_the_summary_holds_what_was_chosen_and_the_gaps(chosen):
    summary = chosen.summary(ticks_s=2.0)
    expected = {
        "cores": 2,
        "large_launches": 40,
        "split_launches": 30,
        "background": "stress: idle priority",
    }
    assert summary["scheduling"] == expected
    gaps = summary["machine_gaps"]
    assert (gaps["count"], gaps["spun_s"], gaps["longest_us"]) == (5, 0.5, 4000.0)
    assert gaps["expected_in_ticks"] == pytest.approx(20.0)
    assert gaps["lost_share"] == pytest.approx(5.9e-3 / 0.5)


def test_the_table_shows_it_under_the_missed_deadlines(run, chosen, monkeypatch):
    text = io.StringIO()
    summary = run.summary | chosen.summary(ticks_s=2.0)
    monkeypatch.setattr(command, "console", Console(file=text, width=160))
    command.print_summary(summary, Path("run"), wall_s=1.0, saving_s=1.0)
    shown = [line for line in text.getvalue().splitlines() if "│" in line]
    assert any(
        "gaps of the machine over 0.2 ms" in line and "20.0 (5 in 0.5 s, longest 4 ms)" in line
        for line in shown
    )
    assert any(
        "split over cores" in line and "30 of 40 large ones, 2 cores" in line for line in shown
    )
    assert any("stress: idle priority" in line for line in shown)


def test_a_run_in_memory_does_not_wait_for_the_clock(run):
    """A study or a chart makes hundreds of them."""
    summary = run.summary
    assert "machine_gaps" not in summary
    assert "background" not in summary["scheduling"]


@pytest.mark.parametrize(
    ("simulated_s", "spun_s"), [(10.0, SPUN_S), (0.1, 0.1 * SPUN_SHARE), (0.0, 0.0)]
)
def test_a_short_run_looks_at_the_clock_for_less(simulated_s, spun_s):
    assert spin_time_s(simulated_s) == pytest.approx(spun_s)
