"""Tests of a study against published worked data and against other codes."""

import csv
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats

from meshes.base.errors import InputError
from tissue.evaluation.statistics.comparison import tukey_tests
from tissue.evaluation.statistics.hpi import composite_index, weights_of
from tissue.evaluation.statistics.hypothesis_test import Effect, cohens_d, partial_eta_squared
from tissue.evaluation.statistics.mixed import mixed_model
from tissue.evaluation.statistics.sign_flips import sign_test
from tissue.evaluation.statistics.strata import (
    multivariate,
    pillai,
    strata,
)
from tissue.evaluation.statistics.trials import TrialTable

pytest.importorskip("statsmodels", reason="statsmodels is not installed: pip install statsmodels")
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


def test_mixed_model_of_the_machines():
    """Pinheiro and Bates (2000, section 1.3): F(2, 10) = 20.6."""
    (test,) = mixed_model(machines_table(), "score")
    assert test.degrees == (2, 10)
    assert test.statistic == pytest.approx(20.58, abs=0.02)
    assert test.p == pytest.approx(0.0003, abs=5e-5)


def test_growth_of_children():
    """The growth of children has the results of SAS PROC GLM.

    They are sex 9.29 (0.0054), age 35.35, both 2.36 (0.0781), epsilon 0.8672.
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


def test_manova_of_skulls():
    """SAS/STAT 9.2 User's Guide, figure 4.5: Pillai's trace 0.44702843, F 0.86."""
    found = multivariate(SKULLS, PLACE, between=True, question="skulls: place")
    assert found.test == "MANOVA, Pillai's trace 0.447"
    assert found.statistic == pytest.approx(0.86, abs=0.005)
    assert float(pillai(SKULLS, PLACE, between=True).trace) == pytest.approx(0.44702843, abs=1e-8)


def test_tukey_of_plants():
    """R's TukeyHSD(aov(weight ~ group, PlantGrowth))."""
    names = ("ctrl", "trt1", "trt2")
    published = (
        (-0.371, -1.0622161, 0.3202161, 0.3908711),
        (0.494, -0.1972161, 1.1852161, 0.1979960),
        (0.865, 0.1737839, 1.5562161, 0.0120064),
    )
    values, groups = np.concatenate(PLANTS)[:, None], np.repeat([0, 1, 2], 10)
    tests = tukey_tests(values, groups, names, between=True, metric="g")
    for pair, (difference, low, high, p) in zip(tests, published, strict=True):
        assert pair.effect.value == pytest.approx(difference, abs=1e-9)
        assert (pair.effect.low, pair.effect.high) == pytest.approx((low, high), abs=2e-6)
        assert pair.p == pytest.approx(p, abs=2e-6)


def test_groups_of_plants_by_strata_and_by_sign_flips():
    """The pair of treatments is that of Welch's t test: t = 3.0101, p = 0.0093 in R."""
    values, groups = np.concatenate(PLANTS), np.repeat([0, 1, 2], 10)
    exact = strata(values[:, None], groups, (1,), between=True)
    assert float(exact.p) == pytest.approx(0.01591, abs=5e-6)  # R: anova, F = 4.8461
    found = sign_test(values[:, None], groups, between=True, rng=np.random.default_rng(RNG))
    welch = stats.ttest_ind(PLANTS[2], PLANTS[1], equal_var=False)
    assert found.statistic == pytest.approx(welch.statistic, rel=1e-9)
    assert found.differences == pytest.approx([-0.371, 0.494, 0.865], abs=1e-9)
    # of three pairs together, between the p of this pair and three times it
    assert welch.pvalue < found.p < 3.0 * welch.pvalue + 0.003


def test_sign_flips_of_few_users_are_exact():
    """Fisher (1935) on Darwin's plants, for eight pairs: all 256 changes of signs."""
    differences = np.array([6.125, -8.375, 1.0, 2.0, 0.75, 2.875, 3.5, 5.125])
    found = sign_test(
        differences[:, None], np.zeros(8, dtype=int), between=False, rng=np.random.default_rng(0)
    )
    signs = np.array(list(product([1.0, -1.0], repeat=8)))
    # the sum of squares is fixed, so that the t statistic grows with the sum
    sums = np.abs((signs * differences).sum(axis=1))
    assert found.p == (sums >= abs(differences.sum()) - 1e-9).mean()
    three = sign_test(
        np.array([[1.0], [2.0], [4.0]]), np.zeros(3, dtype=int), between=False, rng=None
    )
    assert three.p == 0.25


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


def study(seed, *, users=6, trials=5, user=1.0, taste=0.6, trial=0.7, rest=1.0, effect=0.3):
    """Trials of two groups under three methods with known variances."""
    rng = np.random.default_rng(seed)
    rows = []
    for group in ("expert", "novice"):
        for name in range(users):
            user_level, tastes = user * rng.normal(), taste * rng.normal(size=3)
            for number in range(trials):
                shared = trial * rng.normal()
                for index, method in enumerate(("a", "b", "c")):
                    value = (
                        5.0
                        + user_level
                        + tastes[index]
                        + shared
                        + rest * rng.normal()
                        + effect * index
                    )
                    rows.append(
                        {
                            "task": "wall",
                            "group": group,
                            "user": f"u{name}",
                            "trial": number,
                            "method": method,
                            "seed": number,
                            "force_error": value,
                        }
                    )
    return TrialTable.from_rows(rows)


def test_in_a_complete_design_it_is_the_exact_test_of_each_stratum():
    """In a complete design the test is the exact test of each stratum.

    Restricted likelihood has a closed form there, as long as no variance is estimated as zero.
    """
    table = study(1, users=8)
    fitted = mixed_model(table, "force_error")
    cells = table.cells("force_error")
    for test, (within, between) in zip(
        fitted, (((), True), ((0,), False), ((0,), True)), strict=True
    ):
        exact = strata(cells.values, cells.groups, cells.sizes, within, between=between)
        assert test.degrees == exact.degrees
        # The likelihood is flat at its top: the optimiser leaves a per mille or so.
        assert test.statistic == pytest.approx(float(exact.F), rel=5e-3)


METHODS = ("energy", "koopman", "penalty", "perception")


DIRECTIONS = {"force_error": -1, "latency_ms": -1, "arc_length": 1, "position_error_mm": -1}


def rows_of(seed=1, *, users=4, trials=3, groups=("expert", "novice"), tasks=("milling", "wall")):
    """Return a small study whose methods differ by half a standard deviation each.

    One quality drives all metrics.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for task_index, task in enumerate(tasks):
        for group in groups:
            for user in range(users):
                skill = rng.normal()
                for trial in range(trials):
                    for index, method in enumerate(METHODS):
                        good = skill + 0.5 * index + 0.5 * rng.normal()
                        rows.append(
                            {
                                "task": task,
                                "group": group,
                                "user": f"u{user}",
                                "trial": trial,
                                "method": method,
                                "seed": int(rng.integers(2**40)),
                                "force_error": (0.08 - 0.01 * good + 0.004 * rng.normal())
                                * (1 + 4 * task_index),
                                "latency_ms": 4.0 - 0.3 * good + 0.3 * rng.normal(),
                                "arc_length": -2.0 + 0.2 * good + 0.1 * rng.normal(),
                                "position_error_mm": 0.8 - 0.1 * good + 0.2 * rng.normal(),
                            }
                        )
    return rows


def table_of(**options):
    return TrialTable.from_rows(rows_of(**options))


def test_a_table_reads_back_to_the_same_bits(tmp_path):
    rows = rows_of()
    rows[5] = {key: rows[5][key] for key in ("task", "group", "user", "trial", "method", "seed")}
    rows[5]["failure"] = 'the tool left the bone, "quoted", and\na second line'
    table = TrialTable.from_rows(rows)
    table.write_csv(tmp_path / "trials.csv")
    with (tmp_path / "trials.csv").open(encoding="utf-8", newline="") as file:
        back = TrialTable.from_rows(csv.DictReader(file))
    for name in table.metrics:
        np.testing.assert_array_equal(back.metrics[name], table.metrics[name])
    assert back.failed == 1 and sorted(back.failure)[-1] == rows[5]["failure"]
    assert (back.seed == table.seed).all() and back.seed.dtype == np.int64
    back.write_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "trials.csv").read_bytes()


def test_cells_are_means_of_users():
    table = table_of().where(task="wall")
    cells = table.cells("latency_ms")
    assert cells.values.shape == (8, 4) and cells.group_names == ("expert", "novice")
    chosen = (table.group == "novice") & (table.user == "u2") & (table.method == "koopman")
    index = cells.users.index("novice/u2")
    assert cells.values[index, 1] == pytest.approx(
        table.metrics["latency_ms"][chosen].mean(), rel=1e-14
    )
    assert cells.groups[index] == 1 and (cells.counts == 3).all()
    both = table_of().cells("latency_ms", within=("task", "method"))
    assert both.sizes == (2, 4)
    np.testing.assert_allclose(both.values[:, 4:], cells.values, rtol=1e-14)


def test_weights_of_an_index_by_hand():
    """Weights of an index agree with a calculation by hand.

    Two metrics of correlation r have equal weights; three of which two agree weigh by the
    eigenvector.
    """
    weights, loadings, variances = weights_of(np.array([[1.0, 0.6], [0.6, 1.0]]))
    assert weights == pytest.approx([0.5, 0.5]) and variances == pytest.approx([1.6, 0.4])
    three = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]])
    weights, loadings, _ = weights_of(three)
    assert weights == pytest.approx([0.5, 0.5, 0.0], abs=1e-12) and loadings.sum() > 0.0


def test_an_index_needs_users_who_differ():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="users must be at least two in each group, got 1"):
        composite_index(table_of(users=1), DIRECTIONS, rng=rng)
    rows = rows_of(users=2, groups=("expert",))
    # The time of a user is equal in all trials, so it is constant if a user is drawn twice.
    table = TrialTable.from_rows([row | {"time_s": float(row["user"][1:])} for row in rows])
    with pytest.raises(InputError, match="time_s must vary in every bootstrap sample"):
        composite_index(table, DIRECTIONS | {"time_s": -1}, rng=rng)


def test_an_index_orders_what_was_planted():
    found = composite_index(table_of(users=10), DIRECTIONS, rng=np.random.default_rng(5))
    assert sum(each.value for each in found.weights) == pytest.approx(1.0, abs=1e-12)
    assert all(each.low <= each.value <= each.high for each in found.weights)
    means = {each.name: each.value for each in found.means}
    # without a sign of a rounded zero
    assert "-0.00" not in replace(found, means=(Effect("hold", -1e-9, -1e-9, 0.0),)).sentence
    # the order they were planted in
    assert means["energy"] < means["koopman"] < means["penalty"] < means["perception"]
    assert (
        all(each.holds for each in found.assumptions)
        and min(each.value for each in found.weights) > 0.0
    )
