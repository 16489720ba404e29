"""False alarms where nothing differs, and effects found where they were planted."""

import numpy as np
import pytest
from scipy import stats
from simulated_cells import simulated_cells, simulated_power

from tissue.evaluation.statistics.hpi import TESTS, redrawn_power
from tissue.evaluation.statistics.hypothesis_test import mardia
from tissue.evaluation.statistics.mixed import Components
from tissue.evaluation.statistics.strata import (
    mauchly,
    multivariate,
    permutation,
    pillai,
    scores_of,
    shuffled_p,
    shuffled_users,
    strata,
)
from tissue.evaluation.statistics.trials import Cells

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


@pytest.mark.parametrize("name", TESTS)
def test_strata_alarm_at_the_stated_level(name):
    values, groups = null(10_000)
    chosen, between = TESTS[name]
    found = strata(values, groups, (4,), chosen, between=between)
    print(f"null data, {name}: {100 * np.mean(found.p < ALPHA):.1f} % rejected at 5 %")
    assert np.mean(found.p < ALPHA) == pytest.approx(ALPHA, abs=OFF)
    assert stats.kstest(found.p, "uniform").pvalue > 1e-3  # p is uniform, not at 5 % alone


def test_chi_squared_alarms_too_often_with_few_users():
    """Chi squared has over 8 % false alarms with five users a group.

    For this reason Wald's statistic of a mixed model is referred to F.
    """
    values, groups = null(10_000, users=5)
    found = strata(values, groups, (4,), between=True)
    assert np.mean(stats.chi2.sf(2.0 * found.F, 2) < ALPHA) > 0.08
    assert np.mean(found.p < ALPHA) == pytest.approx(ALPHA, abs=OFF)


@pytest.mark.parametrize("name", ["method", "group x method"])
def test_without_sphericity_the_corrected_test_holds(name):
    """Without sphericity the corrected test holds.

    Users react very differently to one method: the plain test alarms too often, Greenhouse and
    Geisser's does not.
    """
    values, groups = null(10_000, users=20)
    values[:, :, 3] += 3.0 * np.random.default_rng(2).normal(size=values.shape[:2])
    chosen, between = TESTS[name]
    found = strata(values, groups, (4,), chosen, between=between)
    assert np.mean(found.p < ALPHA) > ALPHA + 1.5 * OFF
    assert np.mean(found.corrected_p < ALPHA) == pytest.approx(ALPHA, abs=OFF)
    assert mauchly(scores_of(values[0], (4,), (0,)), groups) < 1e-6


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


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTS)
def test_permutations_alarm_at_the_stated_level(name):
    """With 99 shuffles p takes the values 0.01, 0.02 ... so that 5 % is p <= 0.05. Errors are
    far from normal.
    """
    chosen, between = TESTS[name]
    rng = np.random.default_rng(7)
    groups = np.repeat([0, 1, 2], 6)
    alarms = []
    for _ in range(2000):
        values = rng.exponential(size=(18, 1)) + rng.exponential(size=(18, 4))
        found = permutation(
            values, groups, (4,), chosen, between=between, question="?", rng=rng, count=99
        )
        alarms.append(found.p <= ALPHA)
    assert np.mean(alarms) == pytest.approx(ALPHA, abs=OFF)


@pytest.mark.slow
@pytest.mark.parametrize("between", [True, False], ids=["groups", "methods"])
def test_permuted_pillai_alarms_at_the_stated_level(between):
    pytest.importorskip(
        "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
    )
    rng = np.random.default_rng(8)
    groups = np.repeat([0, 1, 2], 6)
    alarms = []
    for _ in range(4000):
        scores = rng.laplace(size=(18, 2))
        measured = float(pillai(scores, groups, between=between).trace)
        others = (
            shuffled_users(scores, 99, rng)
            if between
            else scores * rng.choice([-1.0, 1.0], (99, 18, 1))
        )
        alarms.append(shuffled_p(measured, pillai(others, groups, between=between).trace) <= ALPHA)
    assert np.mean(alarms) == pytest.approx(ALPHA, abs=OFF)
    message = multivariate(scores, groups, between=between, question="?", rng=rng, permutations=999)
    assert message.alternatives[0].statistic == pytest.approx(measured, rel=1e-9)


@pytest.mark.slow
def test_joint_normality_alarms_at_the_stated_level():
    """The two parts share the chance without being independent."""
    rng = np.random.default_rng(9)
    samples = rng.normal(size=(2000, 60, 2))
    alarms = [not mardia(each).holds for each in samples]
    assert 0.02 < np.mean(alarms) < ALPHA + OFF


@pytest.mark.slow
def test_sphericity_alarms_at_the_stated_level():
    values, groups = null(4000, users=20)
    alarms = [mauchly(each, groups) < ALPHA for each in scores_of(values, (4,), (0,))]
    assert np.mean(alarms) == pytest.approx(ALPHA, abs=OFF)


def test_power_of_a_paired_design_is_the_noncentral_f():
    """Rejections of a planted effect against the exact noncentral F (Cohen 1988)."""
    means = np.tile([0.0, 0.15, 0.3, 0.45], (3, 1))
    found = {
        each.test: each
        for each in simulated_power(
            WORLD, means, users_per_group=8, trials=10, rng=np.random.default_rng(11)
        )
    }
    error = WORLD.user_method + WORLD.residual / 10
    shift = 24 * ((means[0] - means[0].mean()) ** 2).sum() / error
    below = 3 * 21
    exact = float(stats.ncf.sf(stats.f.ppf(0.95, 3, below), 3, below, shift))
    assert 0.3 < exact < 0.9
    assert found["method"].hits.low - 0.005 < exact < found["method"].hits.high + 0.005
    for each in found.values():
        assert (
            each.false_alarms.value == pytest.approx(ALPHA, abs=OFF) and each.populations == 10_000
        )
    assert "false alarms" in found["group"].sentence


def test_power_grows_with_users_and_not_beyond_them_with_trials():
    means = np.array([[0.0, 0.0], [0.5, 0.5]])
    rng = np.random.default_rng(12)
    rates = [
        {
            each.test: each.hits.value
            for each in simulated_power(
                WORLD, means, users_per_group=users, trials=trials, rng=rng, populations=2000
            )
        }["group"]
        for users, trials in ((5, 10), (20, 10), (60, 10), (5, 10_000))
    ]
    assert rates[0] < rates[1] < rates[2] and rates[2] > 0.6
    assert rates[3] < rates[1]  # a hundred thousand trials of ten people are ten people


def cells_of(values, groups):
    return Cells(
        "m",
        values,
        np.full(values.shape, TRIALS),
        groups,
        ("a", "b", "c"),
        tuple("u" * len(groups)),
        (("method", tuple("pqrs")),),
    )


def test_redrawn_users_alarm_nearly_at_their_level():
    """Redrawn users alarm nearly at their level.

    Users drawn with replacement appear twice: error rates lie near 5 %, within two points at 12
    users a group.
    """
    shares = []
    for seed in range(8):
        values, groups = null(1, seed=seed)
        found = redrawn_power(
            cells_of(values[0], groups), rng=np.random.default_rng(seed), populations=1000
        )
        shares.append([each.false_alarms.value for each in found])
    assert np.mean(shares, axis=0) == pytest.approx([ALPHA] * 3, abs=0.02)
    assert found[0].users_per_group == USERS
