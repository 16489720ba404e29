"""Planted effects are recovered, and intervals hold the truth as often as they claim."""

import numpy as np
import pytest
from scipy import stats
from simulated_cells import simulated_cells

from tissue.evaluation.statistics.hypothesis_test import cohens_d, partial_eta_squared
from tissue.evaluation.statistics.mixed import Components, regression
from tissue.evaluation.statistics.strata import strata

COVERAGE = pytest.approx(0.95, abs=0.03)
"""Three standard errors of 500 intervals."""


@pytest.mark.slow
@pytest.mark.parametrize("paired", [True, False], ids=["paired", "groups"])
def test_interval_of_cohens_d_covers(paired):
    rng = np.random.default_rng(1)
    held, values = 0, []
    for _ in range(500):
        second = rng.normal(size=12)
        first = second + rng.normal(0.8, 1.0, 12) if paired else rng.normal(0.8, 1.0, 12)
        found = cohens_d(first, second, paired=paired)
        held += found.low <= 0.8 <= found.high
        values.append(found.value)
    assert held / 500 == COVERAGE
    # d is biased upward by 1 + 3 / (4 degrees - 1) (Hedges 1981).
    degrees = 11 if paired else 22
    assert np.mean(values) == pytest.approx(0.8 * (1.0 + 3.0 / (4 * degrees - 1)), abs=0.05)


@pytest.mark.slow
def test_interval_of_partial_eta_squared_covers():
    rng = np.random.default_rng(2)
    groups = np.repeat([0, 1, 2], 12)
    shift = np.array([0.0, 0.4, 0.8])[groups]
    noncentral = 12 * ((np.array([0.0, 0.4, 0.8]) - 0.4) ** 2).sum()
    truth = noncentral / (noncentral + 36)
    found = strata((rng.normal(size=(500, 36)) + shift)[:, :, None], groups, (1,), between=True)
    effects = [partial_eta_squared(float(each), 2, 33) for each in found.F]
    assert np.mean([each.low <= truth <= each.high for each in effects]) == COVERAGE


def test_intervals_of_the_mixed_model_cover():
    """The closed form of the interval covers in 10,000 populations."""
    pytest.importorskip(
        "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
    )
    rng = np.random.default_rng(11)
    planted = np.array([-0.3, 0.0, 0.1, 0.2])
    many, groups = simulated_cells(
        Components(1.0, 0.4, 0.5, 1.0),
        np.tile(planted, (2, 1)),
        users_per_group=6,
        trials=4,
        populations=10_000,
        rng=rng,
    )
    error = strata(many, groups, (4,), (0,), between=False)
    half = stats.t.ppf(0.975, error.degrees[1]) * np.sqrt(error.error_square / 12 * 0.75)
    away = (many - many.mean(axis=2, keepdims=True)).mean(axis=1) - planted
    assert np.mean(np.abs(away) <= half[:, None], axis=0) == pytest.approx([0.95] * 4, abs=0.01)


def trials_of(rng, *, users=15, rows=20, slopes=(0.5, -0.3), between=1.0):
    """A response with two predictors in odd units, users apart."""
    person = np.repeat(np.arange(users), rows)
    columns = {
        "force_error": rng.gamma(4.0, 0.01, len(person)),
        "latency_ms": rng.normal(4.0, 0.5, len(person)),
    }
    value = between * rng.normal(size=users)[person] + rng.normal(size=len(person))
    value += sum(
        slope * each / each.std() for slope, each in zip(slopes, columns.values(), strict=True)
    )
    return value, columns, person


@pytest.mark.slow
def test_credible_intervals_cover():
    rng = np.random.default_rng(6)
    held, shares = [], []
    for _ in range(300):
        values, columns, person = trials_of(rng)
        found = regression(values, columns, person, response="error")
        truth = [
            slope / each.std() for slope, each in zip((0.5, -0.3), columns.values(), strict=True)
        ]
        held.append(
            [
                each.low <= slope <= each.high
                for each, slope in zip(found.slopes, truth, strict=True)
            ]
        )
        shares.append(found.correlation)
    # three standard errors of 300
    assert np.mean(held, axis=0) == pytest.approx([0.95] * 2, abs=0.038)
    assert np.mean(shares) == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_a_slope_that_is_not_there_is_reported_above_zero_half_the_time():
    rng = np.random.default_rng(7)
    chances = []
    for _ in range(300):
        values, columns, person = trials_of(rng, slopes=(0.0, 0.0))
        chances += regression(values, columns, person, response="error").chances[:1]
    assert np.mean((np.array(chances) < 0.025) | (np.array(chances) > 0.975)) == pytest.approx(
        0.05, abs=0.038
    )
    assert stats.kstest(chances, "uniform").pvalue > 1e-3


def test_the_regression_does_not_know_units():
    values, columns, person = trials_of(np.random.default_rng(8))
    once = regression(values, columns, person, response="error")
    again = regression(
        1e3 * values + 7.0,
        {name: 1e-3 * each for name, each in columns.items()},
        person,
        response="error",
    )
    for one, other in zip(once.slopes, again.slopes, strict=True):
        assert (other.value, other.low, other.high) == pytest.approx(
            (1e6 * one.value, 1e6 * one.low, 1e6 * one.high), rel=1e-8
        )


def test_with_a_wide_prior_it_is_least_squares_within_users():
    """With a wide prior the regression is least squares within users.

    The variance between users is far larger than within: slopes equal those of the columns with
    users' means removed.
    """
    values, columns, person = trials_of(np.random.default_rng(9), between=50.0)
    found = regression(values, columns, person, response="error", slope_spread=1e4)
    out = lambda each: each - (np.bincount(person, each) / np.bincount(person))[person]  # noqa: E731
    least, *_ = np.linalg.lstsq(
        np.column_stack([out(each) for each in columns.values()]), out(values), rcond=None
    )
    assert [each.value for each in found.slopes] == pytest.approx(least, rel=2e-3)


@pytest.mark.slow
def test_quadrature_agrees_with_chains():
    """Quadrature and NUTS agree on medians and interval ends within the chains' own error."""
    numpyro = pytest.importorskip(
        "numpyro", reason="numpyro is not installed: it checks the quadrature by chains"
    )
    import jax
    import numpyro.distributions as dist

    rng = np.random.default_rng(10)
    values, columns, person = trials_of(rng, users=10, rows=12)
    ours = regression(values, columns, person, response="error")
    matrix = np.column_stack(list(columns.values()))
    design = (matrix - matrix.mean(axis=0)) / matrix.std(axis=0)
    standard = (values - values.mean()) / values.std()

    def model():
        variance = numpyro.sample("variance", dist.InverseGamma(0.01, 0.01))
        share = numpyro.sample("share", dist.Uniform(0.0, 1.0))
        rest = jax.numpy.sqrt(variance)
        level = numpyro.sample("level", dist.Normal(0.0, 10.0)) * rest
        slopes = numpyro.sample("slopes", dist.Normal(0.0, 10.0).expand([2])) * rest
        users = numpyro.sample("users", dist.Normal(0.0, 1.0).expand([10]))
        user_level = users * rest * jax.numpy.sqrt(share / (1.0 - share))
        numpyro.deterministic("slope", slopes)
        numpyro.sample(
            "seen", dist.Normal(level + design @ slopes + user_level[person], rest), obs=standard
        )

    chains = numpyro.infer.MCMC(
        numpyro.infer.NUTS(model, target_accept_prob=0.9),
        num_warmup=500,
        num_samples=4000,
        progress_bar=False,
    )
    chains.run(jax.random.PRNGKey(0))
    drawn = np.asarray(chains.get_samples()["slope"]) * values.std() / matrix.std(axis=0)
    for index, each in enumerate(ours.slopes):
        low, middle, high = np.quantile(drawn[:, index], [0.025, 0.5, 0.975])
        # 4,000 draws know a median to 2 % of the interval's width and its ends to 3 %.
        width = high - low
        assert each.value == pytest.approx(middle, abs=0.02 * width)
        assert (each.low, each.high) == pytest.approx((low, high), abs=0.03 * width)
    assert ours.correlation == pytest.approx(
        float(np.mean(chains.get_samples()["share"])), abs=0.02
    )
