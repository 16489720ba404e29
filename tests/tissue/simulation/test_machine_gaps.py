"""Gaps of a spinning clock, by clocks whose gaps are known."""

from itertools import accumulate, chain, repeat

import pytest

from tissue.simulation.scheduling import LEAST_GAP_S, spin

LOOK_S = 1e-5


def clock(*steps):
    """Return a clock that advances by those steps [s], and by small ones after them."""
    return accumulate(chain([0.0], steps, repeat(LOOK_S))).__next__


def test_a_clock_that_goes_on_evenly_has_no_gaps():
    gaps = spin(0.01, now=clock())
    assert gaps.gaps_s == () and gaps.spun_s == pytest.approx(0.01, abs=2 * LOOK_S)
    assert gaps.lost_share == gaps.longest_s == gaps.expected(1.0) == 0.0


def test_gaps_are_those_above_the_least():
    gaps = spin(0.01, now=clock(LOOK_S, 0.9 * LEAST_GAP_S, 1.1 * LEAST_GAP_S, LOOK_S, 4e-3))
    assert gaps.gaps_s == pytest.approx((1.1 * LEAST_GAP_S, 4e-3))
    assert gaps.longest_s == pytest.approx(4e-3)
    assert gaps.lost_share == pytest.approx((1.1 * LEAST_GAP_S + 4e-3) / gaps.spun_s)


def test_a_gap_longer_than_the_time_to_look_ends_it():
    gaps = spin(0.01, now=clock(0.05))
    assert gaps.spun_s == pytest.approx(0.05) and gaps.gaps_s == pytest.approx((0.05,))
