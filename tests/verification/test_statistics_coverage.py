"""Planted effects are recovered, and intervals hold the truth as often as they claim."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from tissue.evaluation.statistics.error_rates import QUESTIONS, rejection_rates
from tissue.evaluation.statistics.hypothesis_test import cohens_d, partial_eta_squared
from tissue.evaluation.statistics.mixed import regression
from tissue.evaluation.statistics.sign_flips import pair_scores, sign_test, sign_test_p
from tissue.evaluation.statistics.strata import pillai, strata


class Components(NamedTuple):
    """Variances of users, of users by method, of trials and of the rest."""

    user: float
    user_method: float
    trial: float
    residual: float


def simulated_cells(components, means, *, users_per_group, trials, populations, rng):
    """Draw cell means with normal effects of users, users by method, trials and rest.

    They are drawn at once from their own distribution.

    Means have shape (groups, methods); gives shapes (populations, users, methods) and (users,).
    """
    groups = np.repeat(np.arange(len(means)), users_per_group)
    shape = (populations, len(groups), np.shape(means)[1])
    shared = np.sqrt(components.user + components.trial / trials)
    per_method = np.sqrt(components.user_method + components.residual / trials)
    values = shared * rng.standard_normal((*shape[:2], 1)) + per_method * rng.standard_normal(shape)
    return values + np.asarray(means)[groups], groups


def simulated_power(components, means, *, users_per_group, trials, rng, populations=4_000):
    """Error rates of the tests of methods, groups and both in a study of a given size."""
    values, groups = simulated_cells(
        components,
        means,
        users_per_group=users_per_group,
        trials=trials,
        populations=populations,
        rng=rng,
    )
    null = values - np.asarray(means)[groups]
    return rejection_rates(null[:, None], values[:, None], groups, rng=rng)


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
        "statsmodels", reason="statsmodels is not installed: pip install statsmodels"
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


ALPHA = 0.05


OFF = 0.01
"""Tolerance of the false alarm rate of 5 %.

It is four and a half standard errors of 10,000 replications, two of 2,000.
"""


USERS, TRIALS = 12, 8


WORLD = Components(user=1.0, user_method=0.3, trial=0.5, residual=1.0)


FLAT = np.zeros((3, 4))


def null(count, seed=1, components=WORLD, users=USERS):
    """Cell means of three groups of users under four equal methods."""
    return simulated_cells(
        components,
        FLAT,
        users_per_group=users,
        trials=TRIALS,
        populations=count,
        rng=np.random.default_rng(seed),
    )


@pytest.mark.parametrize("name", QUESTIONS)
def test_strata_alarm_at_the_stated_level(name):
    values, groups = null(10_000)
    chosen, between = QUESTIONS[name]
    found = strata(values, groups, (4,), chosen, between=between)
    print(f"null data, {name}: {100 * np.mean(found.p < ALPHA):.1f} % rejected at 5 %")
    assert np.mean(found.p < ALPHA) == pytest.approx(ALPHA, abs=OFF)
    assert stats.kstest(found.p, "uniform").pvalue > 1e-3  # p is uniform, not at 5 % alone


@pytest.mark.parametrize("name", ["method", "group x method"])
def test_without_sphericity_the_corrected_test_holds(name):
    """Without sphericity the corrected test holds.

    Users react very differently to one method: the plain test alarms too often, Greenhouse and
    Geisser's does not.
    """
    values, groups = null(10_000, users=20)
    values[:, :, 3] += 3.0 * np.random.default_rng(2).normal(size=values.shape[:2])
    chosen, between = QUESTIONS[name]
    found = strata(values, groups, (4,), chosen, between=between)
    assert np.mean(found.p < ALPHA) > ALPHA + 1.5 * OFF
    assert np.mean(found.corrected_p < ALPHA) == pytest.approx(ALPHA, abs=OFF)


@pytest.mark.parametrize("between", [True, False], ids=["groups", "methods"])
def test_manova_alarms_at_the_stated_level(between):
    rng = np.random.default_rng(4)
    mix = rng.normal(size=(4, 4))
    groups = np.repeat([0, 1, 2], USERS)
    scores = rng.normal(size=(10_000, len(groups), 4)) @ mix
    alarms = np.mean(pillai(scores, groups, between=between).p < ALPHA)
    print(
        f"null data, MANOVA of {'groups' if between else 'methods'}: {100 * alarms:.1f} % "
        "rejected at 5 %"
    )
    assert alarms == pytest.approx(ALPHA, abs=OFF)


SPREADS = {
    "equal": np.ones((3, 5)),
    "methods": np.tile([1.0, 2.0, 0.3, 0.15, 0.3], (3, 1)),
    "groups": np.outer([2.0, 1.0, 0.5], np.ones(5)),
}
"""Standard deviations of groups (rows) under methods."""
TEN = np.repeat([0, 1, 2], 10)
"""Groups of a study's size."""


@pytest.mark.parametrize("name", QUESTIONS)
@pytest.mark.parametrize("spreads", SPREADS)
def test_sign_flips_alarm_at_the_stated_level_whatever_the_spreads(spreads, name):
    rng = np.random.default_rng(7)
    values = rng.standard_normal((4000, 30, 5)) * SPREADS[spreads][TEN]
    chosen, between = QUESTIONS[name]
    found = sign_test_p(pair_scores(values, (5,), chosen), TEN, between=between, rng=rng)
    print(f"null data, {spreads} spreads, {name}: {100 * np.mean(found <= ALPHA):.1f} %")
    # a rate of 4,000 data sets has a standard error of 0.35 %
    assert np.mean(found <= ALPHA) == pytest.approx(ALPHA, abs=OFF)


def test_sign_flips_find_what_f_misses():
    """An effect of one standard deviation of a quiet method, next to methods of large spread."""
    rng = np.random.default_rng(8)
    null = rng.standard_normal((500, 30, 5)) * SPREADS["methods"][TEN]
    planted = null.copy()
    # the difference of methods 2 and 4 has a standard deviation of 0.42
    planted[:, :, 2] += 0.42
    found = {
        (each.question, each.test): each
        for each in rejection_rates(null[:, None], planted[:, None], TEN, rng=rng)
    }
    assert found["method", "sign flips"].hits.value > 0.95
    assert found["method", "F of strata"].hits.value < 0.4
    assert found["method", "F of strata"].false_alarms.low > ALPHA + OFF


def test_joint_tests_alarm_at_the_stated_level():
    rng = np.random.default_rng(9)
    mix = rng.normal(size=(2, 2))
    null = np.einsum("pmuk,nm->pnuk", rng.standard_normal((2000, 2, 30, 3)), mix)
    planted = null + 2.0 * (TEN == 1)[:, None]
    found = {
        (each.question, each.test): each for each in rejection_rates(null, planted, TEN, rng=rng)
    }
    assert {question for question, _ in found} == {"method, 2 metrics", "group, 2 metrics"}
    for each in found.values():
        # three standard errors of 2,000
        assert each.false_alarms.value == pytest.approx(ALPHA, abs=0.015)
    assert found["group, 2 metrics", "sign flips"].hits.value > 0.9


@pytest.mark.slow
def test_intervals_of_pairs_cover_together():
    """All ten intervals of differences between methods hold their truth in 95 % of the studies."""
    rng = np.random.default_rng(10)
    means = np.array([0.0, 1.0, 0.1, 0.5, 0.2])
    truth = pair_scores(means[None], (5,), (0,))[0]
    held = 0
    for _ in range(1000):
        values = means + rng.standard_normal((30, 5)) * SPREADS["methods"][TEN]
        scores = pair_scores(values, (5,), (0,))
        found = sign_test(scores, TEN, between=False, rng=rng, flips=499)
        held += bool((np.abs(found.differences - truth) <= found.critical * found.errors).all())
    # three standard errors of 1,000
    assert held / 1000 == pytest.approx(0.95, abs=0.021)


def test_one_data_set_and_many_have_the_same_p():
    rng = np.random.default_rng(11)
    values = rng.standard_normal((3, 8, 4)) + np.array([0.0, 0.6, 0.0, 0.0])
    groups = np.repeat([0, 1], 4)
    for chosen, between in QUESTIONS.values():
        scores = pair_scores(values, (4,), chosen)
        many = sign_test_p(scores, groups, between=between, rng=rng, flips=9_999)
        for each, p in zip(scores, many, strict=True):
            one = sign_test(each, groups, between=between, rng=rng, flips=9_999)
            # four standard errors of a difference of shares
            assert one.p == pytest.approx(p, abs=0.03)
            assert one.p == one.pair_p.min()


def test_sign_flips_of_few_users_are_exact():
    """Four users have 16 flips, of which two give the t of four equal signs."""
    rng = np.random.default_rng(12)
    scores = np.array([[1.0], [1.1], [0.9], [1.2]])
    found = sign_test(scores, np.zeros(4, dtype=int), between=False, rng=rng)
    assert found.p == pytest.approx(2.0 / 16.0, abs=0.01)
    t = scores.mean() / (scores.std(ddof=1) / 2.0)
    assert found.statistic == pytest.approx(t, rel=1e-9)


def test_power_of_a_paired_design_is_the_noncentral_f():
    """Rejections of a planted effect against the exact noncentral F (Cohen 1988)."""
    means = np.tile([0.0, 0.15, 0.3, 0.45], (3, 1))
    found = {
        (each.question, each.test): each
        for each in simulated_power(
            WORLD, means, users_per_group=8, trials=10, rng=np.random.default_rng(11)
        )
    }
    error = WORLD.user_method + WORLD.residual / 10
    shift = 24 * ((means[0] - means[0].mean()) ** 2).sum() / error
    below = 3 * 21
    exact = float(stats.ncf.sf(stats.f.ppf(0.95, 3, below), 3, below, shift))
    assert 0.3 < exact < 0.9
    method = found["method", "F of strata"].hits
    assert method.low - 0.005 < exact < method.high + 0.005
    for each in found.values():
        assert (
            each.false_alarms.value == pytest.approx(ALPHA, abs=OFF) and each.populations == 4_000
        )
    assert "false alarms" in found["group", "sign flips"].sentence
