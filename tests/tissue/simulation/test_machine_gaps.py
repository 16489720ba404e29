"""Gaps of a spinning clock, by clocks whose gaps are known."""

from itertools import accumulate, chain, repeat

import pytest

from tissue.simulation.scheduling import LEAST_GAP_S, Scheduling, spin

LOOK_S = 1e-5


def clock(*steps):
    """Return a clock that advances by those steps [s], and by small ones after them."""
    return accumulate(chain([0.0], steps, repeat(LOOK_S))).__next__


def test_a_clock_that_goes_on_evenly_has_no_gaps():
    spun_s, gaps_s = spin(0.01, now=clock())
    assert gaps_s == [] and spun_s == pytest.approx(0.01, abs=2 * LOOK_S)


def test_gaps_are_those_above_the_least():
    _, gaps_s = spin(0.01, now=clock(LOOK_S, 0.9 * LEAST_GAP_S, 1.1 * LEAST_GAP_S, LOOK_S, 4e-3))
    assert gaps_s == pytest.approx([1.1 * LEAST_GAP_S, 4e-3])


def test_a_gap_longer_than_the_time_to_look_ends_it():
    spun_s, gaps_s = spin(0.01, now=clock(0.05))
    assert spun_s == pytest.approx(0.05) and gaps_s == pytest.approx([0.05])


def test_the_summary_has_the_gaps_of_both_measurements(monkeypatch):
    """Two measurements of 0.1 s with one gap of 4 ms and one of 6 ms; the ticks took 1 s."""
    found = iter([(0.1, [4e-3]), (0.1, [6e-3])])
    monkeypatch.setattr("tissue.simulation.scheduling.spin", lambda seconds: next(found))
    scheduling = Scheduling(None, cores=1, spin_s=0.1)
    scheduling.poll()
    gaps = scheduling.summary(ticks_s=1.0)["machine_gaps"]
    assert gaps == pytest.approx(
        {
            "least_us": 1e6 * LEAST_GAP_S,
            "spun_s": 0.2,
            "count": 2,
            "longest_us": 6000.0,
            "lost_share": 0.05,
            "expected_in_ticks": 10.0,
        }
    )
