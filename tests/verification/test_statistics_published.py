"""Tests of a study against published worked data and against other codes."""

import numpy as np
import pytest
from scipy import stats

from tissue.evaluation.statistics.comparison import compare, tukey_groups, tukey_levels
from tissue.evaluation.statistics.hypothesis_test import (
    cohens_d,
    mardia,
    normal_residuals,
    partial_eta_squared,
)
from tissue.evaluation.statistics.mixed import mixed_model
from tissue.evaluation.statistics.strata import (
    mauchly,
    multivariate,
    permutation,
    pillai,
    scores_of,
    strata,
)
from tissue.evaluation.statistics.trials import TrialTable

pytest.importorskip(
    "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
)
MACHINES = np.array(
    [
        [[52.0, 52.8, 53.1], [62.1, 62.6, 64.0], [67.5, 67.2, 66.9]],
        [[51.8, 52.8, 53.1], [59.7, 60.0, 59.0], [61.5, 61.7, 62.3]],
        [[60.0, 60.2, 58.4], [68.6, 65.8, 69.7], [70.8, 70.6, 71.0]],
        [[51.1, 52.3, 50.3], [63.2, 62.8, 62.2], [64.1, 66.2, 64.0]],
        [[50.9, 51.8, 51.4], [64.8, 65.0, 65.4], [72.1, 72.0, 71.1]],
        [[46.4, 44.8, 49.2], [43.7, 44.2, 43.0], [62.0, 61.4, 60.5]],
    ]
)
"""Productivity of six workers on three machines, three times each (Milliken and Johnson 1992, p.
285).
"""
GIRLS = [
    [21.0, 20.0, 21.5, 23.0],
    [21.0, 21.5, 24.0, 25.5],
    [20.5, 24.0, 24.5, 26.0],
    [23.5, 24.5, 25.0, 26.5],
    [21.5, 23.0, 22.5, 23.5],
    [20.0, 21.0, 21.0, 22.5],
    [21.5, 22.5, 23.0, 25.0],
    [23.0, 23.0, 23.5, 24.0],
    [20.0, 21.0, 22.0, 21.5],
    [16.5, 19.0, 19.0, 19.5],
    [24.5, 25.0, 28.0, 28.0],
]
BOYS = [
    [26.0, 25.0, 29.0, 31.0],
    [21.5, 22.5, 23.0, 26.5],
    [23.0, 22.5, 24.0, 27.5],
    [25.5, 27.5, 26.5, 27.0],
    [20.0, 23.5, 22.5, 26.0],
    [24.5, 25.5, 27.0, 28.5],
    [22.0, 22.0, 24.5, 26.5],
    [24.0, 21.5, 24.5, 25.5],
    [23.0, 20.5, 31.0, 26.0],
    [27.5, 28.0, 31.0, 31.5],
    [23.0, 23.0, 23.5, 25.0],
    [21.5, 23.5, 24.0, 28.0],
    [17.0, 24.5, 26.0, 29.5],
    [22.5, 25.5, 25.5, 26.0],
    [23.0, 24.5, 26.0, 30.0],
    [22.0, 21.5, 23.5, 25.0],
]
"""Distance between two points of a child's skull at 8, 10, 12 and 14 years [mm].

The data are from Potthoff and Roy (1964).
"""
DENTAL = np.array(GIRLS + BOYS)
SEX = np.repeat([0, 1], [len(GIRLS), len(BOYS)])
PLANTS = (
    [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
    [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
    [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
)
"""Dried weight of plants under a control and two treatments (Dobson 1983).

The data are PlantGrowth of R.
"""
SKULLS = np.array(
    [
        [2.068, 2.070, 1.580],
        [2.068, 2.074, 1.602],
        [2.090, 2.090, 1.613],
        [2.097, 2.093, 1.613],
        [2.117, 2.125, 1.663],
        [2.140, 2.146, 1.681],
        [2.045, 2.054, 1.580],
        [2.076, 2.088, 1.602],
        [2.090, 2.093, 1.643],
        [2.111, 2.114, 1.643],
        [2.093, 2.098, 1.653],
        [2.100, 2.106, 1.623],
        [2.104, 2.101, 1.653],
    ]
)
"""Three logarithms of lengths of skulls from three places.

The data are from SAS/STAT 9.2 User's Guide, Introduction to Regression.
"""
PLACE = np.repeat([0, 1, 2], [6, 4, 3])
RNG = 8


def machines_table():
    """The workers' scores as trials; the three repeats on one machine are not those on another."""
    return TrialTable.from_rows(
        {
            "task": "work",
            "group": "all",
            "user": f"w{w}",
            "trial": 3 * m + k,
            "method": "ABC"[m],
            "seed": 0,
            "score": MACHINES[w, m, k],
        }
        for w in range(6)
        for m in range(3)
        for k in range(3)
    )


def dental_table():
    return TrialTable.from_rows(
        {
            "task": "growth",
            "group": "FM"[SEX[child]],
            "user": f"c{child:02d}",
            "trial": 0,
            "method": f"{age:02d}",
            "seed": 0,
            "distance_mm": DENTAL[child, index],
        }
        for child in range(len(DENTAL))
        for index, age in enumerate((8, 10, 12, 14))
    )


def test_mixed_model_of_the_machines():
    """Pinheiro and Bates (2000, section 1.3): 4.78105, 3.72953 and 0.96158; F(2, 10) = 20.6."""
    model = mixed_model(machines_table(), "score")
    found = model.components
    # the optimiser stops at a gradient of 1e-5
    assert found.user**0.5 == pytest.approx(4.78105, rel=2e-3)
    assert found.user_method**0.5 == pytest.approx(3.729532, rel=1e-3)
    assert found.residual**0.5 == pytest.approx(0.9615771, rel=1e-3)
    assert found.trial == 0.0
    (test,) = model.tests
    assert test.degrees == (2, 10)
    assert test.statistic == pytest.approx(20.58, abs=0.02)
    assert test.p == pytest.approx(0.0003, abs=5e-5)


def test_strata_of_the_machines_are_the_same_test():
    found = strata(MACHINES.mean(axis=2), np.zeros(6, dtype=int), (3,), (0,), between=False)
    assert float(found.F) == pytest.approx(20.58, abs=0.005) and found.degrees == (2, 10)


def test_growth_of_children():
    """The growth of children has the results of SAS PROC GLM.

    They are sex 9.29 (0.0054), age 35.35, both 2.36 (0.0781), epsilon 0.8672, Mauchly 0.1997.
    """
    sex = strata(DENTAL, SEX, (4,), between=True)
    age = strata(DENTAL, SEX, (4,), (0,), between=False)
    both = strata(DENTAL, SEX, (4,), (0,), between=True)
    assert (sex.degrees, age.degrees, both.degrees) == ((1, 25), (3, 75), (3, 75))
    assert [round(float(each.F), 2) for each in (sex, age, both)] == [9.29, 35.35, 2.36]
    assert float(sex.p) == pytest.approx(0.0054, abs=5e-5) and float(both.p) == pytest.approx(
        0.0781, abs=5e-5
    )
    assert float(age.epsilon) == pytest.approx(0.8672, abs=5e-5)
    assert mauchly(scores_of(DENTAL, (4,), (0,)), SEX) == pytest.approx(0.1997, abs=5e-5)


def test_comparison_of_children_names_what_fails():
    found = compare(dental_table(), "distance_mm", task="growth", rng=np.random.default_rng(RNG))
    method, group, both = found.tests
    assert (round(group.statistic, 2), round(method.statistic, 2), round(both.statistic, 2)) == (
        9.29,
        35.35,
        2.36,
    )
    assert {each.test for each in method.alternatives} == {"permutation", "Greenhouse-Geisser"}
    normal = next(each for each in method.assumptions if each.name == "normal residuals")
    assert not normal.holds  # one boy shrinks by 5 mm from 12 to 14 years
    assert not method.sound and method.found


def test_manova_of_skulls():
    """SAS/STAT 9.2 User's Guide, figure 4.5: Pillai's trace 0.44702843, F 0.86."""
    found = multivariate(
        SKULLS, PLACE, between=True, question="skulls: place", rng=np.random.default_rng(RNG)
    )
    assert found.test == "MANOVA, Pillai's trace 0.447"
    assert found.statistic == pytest.approx(0.86, abs=0.005)
    assert float(pillai(SKULLS, PLACE, between=True).trace) == pytest.approx(0.44702843, abs=1e-8)


@pytest.mark.parametrize("between", [True, False], ids=["groups", "mean"])
@pytest.mark.parametrize("width", [2, 5])
def test_pillai_is_that_of_statsmodels(between, width):
    from statsmodels.multivariate.manova import MANOVA

    rng = np.random.default_rng(width)
    scores, groups = rng.normal(0.3, 1.0, (24, width)), np.repeat([0, 1, 2], [9, 8, 7])
    ours = pillai(scores, groups, between=between)
    hypothesis = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]) if between else np.ones((1, 3))
    model = MANOVA(scores, np.equal.outer(groups, np.arange(3)).astype(float))
    theirs = model.mv_test([("effect", hypothesis)])["effect"]["stat"].loc["Pillai's trace"]
    assert float(ours.trace) == pytest.approx(theirs["Value"], rel=1e-8)
    assert float(ours.p) == pytest.approx(theirs["Pr > F"], rel=1e-8)


def test_tukey_of_plants():
    """R's TukeyHSD(aov(weight ~ group, PlantGrowth))."""
    names = ("ctrl", "trt1", "trt2")
    published = (
        (-0.371, -1.0622161, 0.3202161, 0.3908711),
        (0.494, -0.1972161, 1.1852161, 0.1979960),
        (0.865, 0.1737839, 1.5562161, 0.0120064),
    )
    for pair, (difference, low, high, p) in zip(
        tukey_groups(PLANTS, names, metric="g"), published, strict=True
    ):
        assert pair.effect.value == pytest.approx(difference, abs=1e-9)
        assert (pair.effect.low, pair.effect.high) == pytest.approx((low, high), abs=2e-6)
        assert pair.p == pytest.approx(p, abs=2e-6)


def test_groups_of_plants_by_strata_and_by_permutation():
    values, groups = np.concatenate(PLANTS), np.repeat([0, 1, 2], 10)
    exact = strata(values[:, None], groups, (1,), between=True)
    assert float(exact.p) == pytest.approx(0.01591, abs=5e-6)  # R: anova, F = 4.8461
    shuffled = permutation(
        values[:, None],
        groups,
        (1,),
        (),
        between=True,
        question="g",
        rng=np.random.default_rng(RNG),
    )
    assert shuffled.p == pytest.approx(0.0159, abs=0.006)  # three standard errors of 4,999 shuffles


def test_normality_of_plants():
    """R: shapiro.test of the residuals, p = 0.4379."""
    residuals = np.concatenate([np.array(each) - np.mean(each) for each in PLANTS])
    found = normal_residuals(residuals)
    assert found.holds and "Shapiro-Wilk p = 0.4379" in found.finding


def test_tukey_within_users_of_two_levels_is_the_paired_test():
    rng = np.random.default_rng(10)
    values = rng.normal([0.0, 0.6], size=(12, 2))
    (pair,) = tukey_levels(values, ("a", "b"), np.zeros(12, dtype=int), metric="m")
    assert pair.p == pytest.approx(
        float(stats.ttest_rel(values[:, 0], values[:, 1]).pvalue), rel=1e-6
    )
    assert "b minus a" in pair.question and pair.effect.value > 0.0


@pytest.mark.parametrize("within", [(0,), (1,), (0, 1)], ids=["first", "second", "both"])
def test_strata_are_the_analysis_of_variance_of_statsmodels(within):
    import pandas as pd
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    rng = np.random.default_rng(11)
    values = rng.normal(size=(9, 12)) + rng.normal(size=(9, 1))
    frame = pd.DataFrame(
        [{"u": u, "a": k // 4, "b": k % 4, "y": values[u, k]} for u in range(9) for k in range(12)]
    )
    rows = anova_lm(ols("y ~ C(a) * C(b) + C(u) + C(u):C(a) + C(u):C(b)", frame).fit())
    effect = {(0,): "C(a)", (1,): "C(b)", (0, 1): "C(a):C(b)"}[within]
    error = {(0,): "C(u):C(a)", (1,): "C(u):C(b)", (0, 1): "Residual"}[within]
    ours = strata(values, np.zeros(9, dtype=int), (3, 4), within, between=False)
    assert float(ours.F) == pytest.approx(
        rows.loc[effect, "mean_sq"] / rows.loc[error, "mean_sq"], rel=1e-9
    )
    assert ours.degrees == (rows.loc[effect, "df"], rows.loc[error, "df"])


def test_effects_by_their_definitions():
    first, second = np.array([2.0, 4.0, 6.0, 8.0]), np.array([1.0, 3.0, 4.0, 6.0])
    assert cohens_d(first, second).value == pytest.approx(1.5 / np.sqrt((20.0 + 13.0) / 6.0))
    assert cohens_d(first, second, paired=True).value == pytest.approx(
        1.5 / np.std([1.0, 1.0, 2.0, 2.0], ddof=1)
    )
    eta = partial_eta_squared(5.0, 2.0, 27.0)
    assert eta.value == pytest.approx(10.0 / 37.0) and eta.low < eta.value < eta.high
    # An interval that just excludes zero belongs to a p of 2.5 %.
    edge = stats.t.ppf(0.975, 18) / np.sqrt(5.0)
    shift = np.linspace(-1.0, 1.0, 10) * 0.7
    sample = shift / shift.std(ddof=1)
    assert cohens_d(sample + edge, sample).low == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("statistic", [1e-6, 0.3, 40.0, 5e4])
def test_intervals_of_extreme_effects_are_finite(statistic):
    eta = partial_eta_squared(statistic, 3.0, 81.0)
    assert 0.0 <= eta.low <= eta.high <= 1.0 and np.isfinite([eta.low, eta.high]).all()
    shift = np.linspace(-1.0, 1.0, 10)
    far = cohens_d(shift + statistic, shift)
    assert far.low <= far.value <= far.high


def test_mardia_of_a_skew_cloud():
    assert not mardia(np.random.default_rng(13).exponential(size=(200, 3))).holds


def test_tukey_within_users_takes_the_range_of_the_levels_over_the_error_of_their_interaction():
    rng = np.random.default_rng(14)
    values, groups = rng.normal(size=(30, 4)) + rng.normal(size=(30, 1)), np.repeat([0, 1, 2], 10)
    error = strata(values, groups, (4,), (0,), between=False)
    widest = max(each.statistic for each in tukey_levels(values, "abcd", groups, metric="m"))
    assert widest == pytest.approx(
        np.ptp(values.mean(axis=0)) / np.sqrt(float(error.error_square) / 30), rel=1e-12
    )
