"""What wrong priors and wrong noise cost the estimates: figures with bounds, so that a change of them is seen."""

import numpy as np
import pytest

from tissue.perception.sensitivity import map_estimate_errors, recursive_estimate_errors


@pytest.fixture(scope="module")
def look():
    return {each.assumed: each.error for each in map_estimate_errors(np.random.default_rng(0))}


@pytest.fixture(scope="module")
def recursion():
    return {each.assumed: each for each in recursive_estimate_errors(np.random.default_rng(0))}


def test_a_right_prior_makes_a_look_better_and_no_wrong_one_much_worse(look):
    """Threefold wrong medians and twofold wrong spreads cost at most an eighth over the look alone."""
    assert look["the look itself"] == pytest.approx(1.0, abs=0.02)  # standard error 0.5 %
    assert look["right prior and noise"] < 0.95
    assert all(error < 1.125 for assumed, error in look.items() if "fatigues" not in assumed)
    assert look["right prior and noise"] <= min(error for assumed, error in look.items() if "prior's" in assumed) + 0.01


def test_a_bias_matters_more_than_any_wrong_spread(look, recursion):
    """No prior sees fatigue: of one look it costs 20 %, of the recursion, which averages noise away, fourfold."""
    assert look["truth fatigues by 10 %"] == max(look.values()) > 1.15
    assert recursion["truth fatigues by 10 %"].error > 3.0 and recursion["truth fatigues by 10 %"].held < 0.3


def test_the_recursion_knows_its_error_where_its_variances_are_right(recursion):
    """2.0e5 looks in 200 runs of some ten independent stretches: 2 % of scatter in the share."""
    right = recursion["right variances"]
    assert right.error == pytest.approx(1.0, abs=0.05) and right.held == pytest.approx(0.95, abs=0.03)
    tails = recursion["truth has heavy tails"]  # linear: only the variance counts
    assert tails.error == pytest.approx(1.0, abs=0.07) and tails.held == pytest.approx(0.95, abs=0.03)


def test_wrong_variances_add_a_third_to_the_error_and_change_the_coverage(recursion):
    """A gain wrong by sqrt(10) costs the same in either direction: r^2 + 1 / r^2 over 2 r at r = 10^(1/4) is 1.3."""
    for assumed in ("wander / 10", "wander x 10", "noise / 10"):
        assert 1.2 < recursion[assumed].error < 1.4
    assert recursion["wander x 10"].held > 0.97 and recursion["noise / 10"].held < 0.7
