"""Maximum-posterior estimate against a brute-force grid (E7)."""

import numpy as np
import pytest
from perceived_estimates import log_posterior, map_force_N
from tissue.perception.estimate import (
    FATIGUE,
    LOG_SPREAD,
    MEDIAN_N,
    NOISE_N,
    TAIL,
    map_estimate_errors,
    recursive_estimate_errors,
)

NODES = 2000


def cases(count, seed):
    """Return observations, noises and priors.

    A third is negative or zero, a quarter has two turning points.
    """
    rng = np.random.default_rng(seed)
    middle = rng.normal(0.0, 1.5, count)
    spread = np.exp(rng.uniform(np.log(0.05), np.log(2.5), count))
    noise = np.exp(rng.uniform(np.log(0.01), np.log(3.0), count))
    drawn = np.exp(
        middle + spread * rng.standard_normal(count)
    ) + 3.0 * noise * rng.standard_normal(count)
    below = -rng.exponential(2.0, count) * (rng.random(count) < 0.8)
    return np.where(rng.random(count) < 0.35, below, drawn), noise, middle, spread


def two_maxima(count, seed):
    """Return observations for which half of the posteriors have two maxima.

    They lie 20 to 400 medians above the prior.
    """
    rng = np.random.default_rng(seed)
    spread, seen = (
        rng.uniform(0.15, 0.6, count),
        np.exp(rng.uniform(np.log(20.0), np.log(400.0), count)),
    )
    noise = spread * np.sqrt(seen * np.exp(1.0 - spread**2 + rng.uniform(0.0, np.log(6.0), count)))
    return seen, noise, np.zeros(count), spread


def maxima(seen, noise, middle, spread):
    """Return the number of local maxima on a dense grid, shape (count,)."""
    u = np.linspace(middle - 4.0 * spread - 1.0, np.log(seen) + 2.0, NODES)
    rising = np.diff(log_posterior(u, seen, noise, middle, spread), axis=0) > 0.0
    return (rising[:-1] & ~rising[1:]).sum(axis=0)


def off_the_grid(seen, noise, middle, spread):
    """Compute how far the estimate lies from the grid's best point.

    Returns the increase of the log posterior at the grid's best point over ours, and the distance
    between both in cells; shapes (count,).
    """
    found = np.log(map_force_N(seen, noise, median_N=np.exp(middle), log_spread=spread))
    ours = log_posterior(found, seen, noise, middle, spread)
    better, cells = [], []
    low = np.minimum(np.log(np.maximum(seen, 1e-3)), middle) - 8.0 * spread - 3.0
    high = np.maximum(np.log(np.maximum(seen, 1e-3)), middle) + 3.0
    for first in range(0, len(seen), 1000):
        part = slice(first, first + 1000)
        u = np.linspace(low[part], high[part], NODES)
        heights = log_posterior(u, seen[part], noise[part], middle[part], spread[part])
        best = heights.argmax(axis=0)[None]
        better.append(np.take_along_axis(heights, best, 0)[0] - ours[part])
        cells.append(np.abs(np.take_along_axis(u, best, 0)[0] - found[part]) / (u[1] - u[0]))
    return np.concatenate(better), np.concatenate(cells)


@pytest.mark.parametrize(
    ("count", "seed"), [(4000, 0), pytest.param(100_000, 10, marks=pytest.mark.slow)]
)
def test_it_is_the_best_of_a_grid(count, seed):
    for given in (cases(count, seed), two_maxima(count // 4, seed + 1)):
        better, cells = off_the_grid(*given)
        print(f"{len(better)} posteriors: the grid is better by {better.max():.0e} at most")
        assert better.max() < 1e-9  # rounding of a logarithm of density of up to 1e4
        assert cells.max() < 1.0 + 1e-6  # the grid's best is a neighbour of the true maximum


def test_bimodal_posteriors_are_among_them_and_both_sides_win():
    given = two_maxima(2000, 3)
    both = maxima(*given) == 2
    assert both.mean() > 0.3
    upper = map_force_N(given[0], given[1], median_N=1.0, log_spread=given[3]) > 0.4 * given[0]
    assert 0.05 < upper[both].mean() < 0.95


def test_it_is_defined_for_every_real_observation():
    seen = np.array([-1e6, -3.0, -1e-9, 0.0, 1e-12, 1.0, 1e6])
    found = map_force_N(seen, 0.2)
    assert np.isfinite(found).all() and (found > 0.0).all()
    assert (np.diff(found[3:]) > 0.0).all() and found[-1] == pytest.approx(1e6)
    assert map_force_N(2.0, 0.1).shape == () and map_force_N(np.ones((3, 1)), [0.1, 0.2]).shape == (
        3,
        2,
    )


def test_limits_are_the_prior_and_the_observation():
    assert map_force_N(5.0, 1e-6, median_N=1.0, log_spread=1.0) == pytest.approx(5.0, rel=1e-9)
    assert map_force_N(5.0, 1e9, median_N=2.0, log_spread=0.5) == pytest.approx(
        2.0 * np.exp(-0.25), rel=1e-9
    )


@pytest.mark.parametrize(("spreads", "possible"), [(5.9, True), (6.1, False)])
def test_a_prior_excludes_what_lies_six_deviations_beyond_its_sixth(spreads, possible):
    """A prior excludes forces six noises beyond its six deviations.

    The highest force is exp(6 s) medians, and an observation may be 6 noises above it; below, 6
    noises under exp(-6 s).
    """
    median, spread, noise = 2.0, 0.2, 0.05
    for seen in (
        median * np.exp(6 * spread) + spreads * noise,
        median * np.exp(-6 * spread) - spreads * noise,
    ):
        if possible:
            require_prior_fits(seen, noise, median_N=median, log_spread=spread)
        else:
            with pytest.raises(InputError, match="seen_N"):
                require_prior_fits(seen, noise, median_N=median, log_spread=spread)


@pytest.fixture(scope="module")
def look():
    return {each.assumed: each.error for each in map_estimate_errors(np.random.default_rng(0))}


@pytest.fixture(scope="module")
def recursion():
    return {each.assumed: each for each in recursive_estimate_errors(np.random.default_rng(0))}


def test_a_right_prior_makes_a_look_better_and_no_wrong_one_much_worse(look):
    """A right prior improves an observation, and no wrong one makes it much worse.

    Threefold wrong medians and twofold wrong spreads cost at most an eighth over the observation
    alone.
    """
    assert look["the look itself"] == pytest.approx(1.0, abs=0.02)  # standard error 0.5 %
    assert look["right prior and noise"] < 0.95
    assert all(error < 1.125 for assumed, error in look.items() if "fatigues" not in assumed)
    assert (
        look["right prior and noise"]
        <= min(error for assumed, error in look.items() if "prior's" in assumed) + 0.01
    )


def test_a_bias_matters_more_than_any_wrong_spread(look, recursion):
    """A bias matters more than any wrong spread, because no prior knows of fatigue.

    For one observation it costs 20 %. For the recursion, which averages noise away, it costs
    fourfold.
    """
    assert look["truth fatigues by 10 %"] == max(look.values()) > 1.15
    assert (
        recursion["truth fatigues by 10 %"].error > 3.0
        and recursion["truth fatigues by 10 %"].held < 0.3
    )


def test_the_recursion_knows_its_error_where_its_variances_are_right(recursion):
    """2.0e5 looks in 200 runs of some ten independent stretches: 2 % of scatter in the share."""
    right = recursion["right variances"]
    assert right.error == pytest.approx(1.0, abs=0.05) and right.held == pytest.approx(
        0.95, abs=0.03
    )
    tails = recursion["truth has heavy tails"]  # linear: only the variance counts
    assert tails.error == pytest.approx(1.0, abs=0.07) and tails.held == pytest.approx(
        0.95, abs=0.03
    )


def test_wrong_variances_add_a_third_to_the_error_and_change_the_coverage(recursion):
    """Wrong variances add a third to the error and change the coverage.

    A gain wrong by sqrt(10) costs the same in either direction: r^2 + 1 / r^2 over 2 r at r =
    10^(1/4) is 1.3.
    """
    for assumed in ("wander / 10", "wander x 10", "noise / 10"):
        assert 1.2 < recursion[assumed].error < 1.4
    assert recursion["wander x 10"].held > 0.97 and recursion["noise / 10"].held < 0.7


def brute_force_N(seen_N, noise_N, median_N, log_spread):
    """Return the force of maximum posterior density, by evaluating 1,000 forces per observation."""
    logs = np.linspace(np.log(1e-3), np.log(300.0), 1000)
    prior = -0.5 * ((logs - np.log(median_N)) / log_spread) ** 2 - logs
    found = [
        logs[np.argmax(prior - 0.5 * ((seen - np.exp(logs)) / noise_N) ** 2)] for seen in seen_N
    ]
    return np.exp(found)


def test_errors_of_one_look_are_those_of_other_draws_and_a_search_by_brute_force(look):
    """5,000 looks: 1 % of standard error, and of heavy tails and of a strong bias a few."""
    rng = np.random.default_rng(9)
    truth = MEDIAN_N * np.exp(LOG_SPREAD * rng.standard_normal(5000))
    gaussian = truth + NOISE_N * rng.standard_normal(5000)
    heavy = truth + NOISE_N * rng.standard_t(TAIL, 5000) * np.sqrt((TAIL - 2.0) / TAIL)
    right = NOISE_N, MEDIAN_N, LOG_SPREAD
    cases = {
        "right prior and noise": (gaussian, *right),
        "prior's median / 3": (gaussian, NOISE_N, MEDIAN_N / 3.0, LOG_SPREAD),
        "prior's median x 3": (gaussian, NOISE_N, MEDIAN_N * 3.0, LOG_SPREAD),
        "prior's spread / 2": (gaussian, NOISE_N, MEDIAN_N, LOG_SPREAD / 2.0),
        "prior's spread x 2": (gaussian, NOISE_N, MEDIAN_N, LOG_SPREAD * 2.0),
        "noise / 2": (gaussian, NOISE_N / 2.0, MEDIAN_N, LOG_SPREAD),
        "noise x 2": (gaussian, NOISE_N * 2.0, MEDIAN_N, LOG_SPREAD),
        "truth has heavy tails": (heavy, *right),
        "truth fatigues by 10 %": (gaussian + FATIGUE * truth, *right),
    }
    for assumed, given in cases.items():
        error = np.sqrt(np.mean((brute_force_N(*given) - truth) ** 2)) / NOISE_N
        assert look[assumed] == pytest.approx(error, rel=0.08 if "truth" in assumed else 0.04)
