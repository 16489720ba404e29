"""Maximum-posterior estimate against a brute-force grid."""

import numpy as np
import pytest

from tissue.perception.estimate import log_posterior, map_force_N

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


def test_e7_a_climb_from_one_start_ends_on_the_lower_maximum_of_some():
    """A climb from one start ends on the lower maximum in some cases.

    It moves uphill from the prior's median, or from the observation, along the exact slope, in
    steps of at most 0.02.
    """
    given = two_maxima(1000, 4)
    both = maxima(*given) == 2
    seen, noise, middle, spread = (each[both] for each in given)
    best = np.log(map_force_N(seen, noise, median_N=1.0, log_spread=spread))
    for start in (middle, np.log(seen)):
        u = start.copy()
        for _ in range(600):
            w = np.exp(u)
            slope = -(u - middle) / spread**2 - 1.0 + (seen - w) * w / noise**2
            u += 0.02 * np.tanh(slope)
        lower = (
            log_posterior(u, seen, noise, middle, spread)
            < log_posterior(best, seen, noise, middle, spread) - 0.1
        )
        assert lower.mean() > 0.05


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
