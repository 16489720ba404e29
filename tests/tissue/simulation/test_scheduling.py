"""Choices for a run and lateness of the machine, in the summary and in the printed table."""

import pytest

from kernels.launcher import LaunchCounts
from tissue.models.tissue_model import FreeSpace
from tissue.simulation import loop
from tissue.simulation.loop import Scheduling
from tissue.system.priorities import MachineGaps


class Background(FreeSpace):
    """Tissue that works in the background, next to the ticks."""

    scheduling = "stress: idle priority"


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
