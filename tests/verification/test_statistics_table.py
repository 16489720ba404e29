"""The table of trials, the composite index, and one sentence for whatever cannot be compared."""

import csv
import warnings

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.evaluation.statistics.comparison import across_tasks, compare, tukey_groups
from tissue.evaluation.statistics.hpi import composite_index, redrawn_power, weights_of
from tissue.evaluation.statistics.hypothesis_test import Assumption, HypothesisTest
from tissue.evaluation.statistics.mixed import mixed_model, regression, trial_regression
from tissue.evaluation.statistics.strata import manova
from tissue.evaluation.statistics.trials import TrialTable

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


def test_a_table_does_not_know_who_finished_first(tmp_path):
    rows = rows_of()
    shuffled = [rows[i] for i in np.random.default_rng(2).permutation(len(rows))]
    TrialTable.from_rows(rows).write_csv(tmp_path / "a.csv")
    TrialTable.from_rows(shuffled).write_csv(tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


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


def test_a_user_whose_trials_all_failed_is_left_out_and_named():
    rows = [
        row
        | ({"failure": "diverged"} if row["user"] == "u1" and row["method"] == "penalty" else {})
        for row in rows_of()
    ]
    found = compare(
        TrialTable.from_rows(rows), "latency_ms", task="wall", rng=np.random.default_rng(3)
    )
    assert found.cells.dropped == ("expert/u1", "novice/u1")
    assert "2 users without a whole set of trials are left out" in found.tests[0].note


@pytest.mark.slow
@pytest.mark.parametrize("kept", ["one method", "one group", "gaps"])
def test_studies_that_are_not_whole_are_compared(kept):
    """Incomplete studies are compared.

    One method leaves the test of groups, one group the test of methods. Failed trials leave unequal
    numbers, which are reported.
    """
    pytest.importorskip(
        "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
    )
    table = table_of(users=5)
    if kept == "gaps":
        rng = np.random.default_rng(9)
        table = TrialTable.from_rows(
            row | ({"failure": "diverged"} if rng.random() < 0.1 else {})
            for row in rows_of(users=5)
        )
    table = {
        "one method": lambda: table.where(method="energy"),
        "one group": lambda: table.where(group="novice"),
    }.get(kept, lambda: table)()
    found = compare(table, "force_error", task="wall", rng=np.random.default_rng(10))
    wanted = {
        "one method": ["group"],
        "one group": ["method"],
        "gaps": ["group", "group x method", "method"],
    }[kept]
    assert sorted(each.question.split(": ")[1] for each in found.tests) == wanted
    mixed = mixed_model(table.where(task="wall"), "force_error")
    assert sorted(each.question.split(": ")[1] for each in mixed.tests) == wanted
    assert all(0.0 <= each.p <= 1.0 for each in (*found.tests, *mixed.tests, *found.pairs))
    assert ("unequal numbers of trials" in found.tests[0].note) == (kept == "gaps")


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


def test_an_index_does_not_know_units():
    rows = rows_of()
    scaled = [
        row
        | {"force_error": 100.0 * row["force_error"], "latency_ms": 1e-3 * row["latency_ms"] + 7.0}
        for row in rows
    ]
    one = composite_index(TrialTable.from_rows(rows), DIRECTIONS, rng=np.random.default_rng(4))
    other = composite_index(TrialTable.from_rows(scaled), DIRECTIONS, rng=np.random.default_rng(4))
    for ours, theirs in zip(
        (*one.weights, *one.means), (*other.weights, *other.means), strict=True
    ):
        assert (theirs.value, theirs.low, theirs.high) == pytest.approx(
            (ours.value, ours.low, ours.high), abs=1e-9
        )


def test_an_index_orders_what_was_planted():
    found = composite_index(table_of(users=10), DIRECTIONS, rng=np.random.default_rng(5))
    assert sum(each.value for each in found.weights) == pytest.approx(1.0, abs=1e-12)
    assert all(each.low <= each.value <= each.high for each in found.weights)
    means = {each.name: each.value for each in found.means}
    # the order they were planted in
    assert means["energy"] < means["koopman"] < means["penalty"] < means["perception"]
    assert all(each.holds for each in found.assumptions)


def test_raw_components_have_mixed_signs_and_follow_the_units():
    """Raw components have mixed signs and follow the units (E14).

    Weights from the covariance of raw metrics add good to bad values, and change with millimetres.
    """
    table = table_of(users=10).where(task="wall")

    def raw(factor):
        columns = np.column_stack([table.values(name) for name in DIRECTIONS])
        columns[:, 3] *= factor
        return np.linalg.eigh(np.cov(columns.T))[1][:, -1]

    millimetres, metres = raw(1.0), raw(1e-3)
    assert millimetres.min() < 0.0 < millimetres.max()
    assert (millimetres**2)[3] > 10.0 * (metres**2)[3]


def test_an_index_of_metrics_that_contradict_is_reported():
    table = table_of(users=10)
    found = composite_index(table, DIRECTIONS | {"latency_ms": 1}, rng=np.random.default_rng(6))
    assert (
        not found.assumptions[0].holds
        and "better by one metric goes with worse by another" in found.sentence
    )


def test_weights_of_noise_are_not_called_stable():
    rng = np.random.default_rng(7)
    rows = [row | {name: rng.normal() for name in DIRECTIONS} for row in rows_of()]
    found = composite_index(TrialTable.from_rows(rows), DIRECTIONS, rng=rng)
    assert not found.assumptions[2].holds and "weights move by up to" in found.sentence


def test_a_test_states_its_figures():
    found = HypothesisTest(
        "Welch",
        "m: group",
        "F",
        5.2,
        (2, 17.1),
        0.0123,
        assumptions=(Assumption("normal residuals", False, "?"),),
    )
    assert found.figures == "F(2, 17.1) = 5.2, p = 0.0123"
    assert found.found and not found.sound


@pytest.mark.slow
def test_a_whole_analysis_runs_without_a_warning_and_repeats():
    pytest.importorskip(
        "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
    )
    table = table_of(users=8)

    def analysis():
        rng = np.random.default_rng(8)
        found = compare(table, "force_error", task="wall", rng=rng)
        both = [
            manova(table.where(task="wall"), list(DIRECTIONS)[:2], factor=each, rng=rng)
            for each in ("group", "method")
        ]
        slopes = trial_regression(
            table, "position_error_mm", ["force_error", "latency_ms"]
        ).sentence
        rates = [each.sentence for each in redrawn_power(found.cells, rng=rng, populations=500)]
        mixed = across_tasks(table.where(task="wall"), "force_error", rng=rng)
        return (
            [
                (each.question, each.figures)
                for each in (*mixed.tests, *found.tests, *found.pairs, *both)
            ],
            slopes,
            rates,
        )

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first = analysis()
    assert first == analysis()
    assert first[0][1][0] == "force_error: method" and first[0][1][1].startswith("F(3, 42)")


LONE = {"groups": ("novice",), "users": 1}
REFUSED = {
    "twice": (
        lambda: TrialTable.from_rows(rows_of()[:1] * 2),
        "trial must be given once, got task milling, group expert",
    ),
    "nan": (
        lambda: TrialTable.from_rows([row | {"latency_ms": np.nan} for row in rows_of()]),
        "latency_ms must be finite, got nan in task milling",
    ),
    "no such metric": (
        lambda: table_of().cells("error"),
        "metric must be one of force_error, latency_ms",
    ),
    "one user": (
        lambda: table_of(users=1).cells("latency_ms"),
        "group expert must keep at least two users",
    ),
    "all failed": (
        lambda: TrialTable.from_rows([row | {"failure": "x"} for row in rows_of()]).cells(
            "latency_ms"
        ),
        "group expert must keep at least two users with trials of latency_ms at every level, got 0",
    ),
    "constant": (
        lambda: TrialTable.from_rows([row | {"latency_ms": 4.0} for row in rows_of()]).cells(
            "latency_ms"
        ),
        "latency_ms must vary over the trials, got 4 in all",
    ),
    "nothing to compare": (
        lambda: compare(
            table_of(groups=("novice",)).where(method="energy"),
            "latency_ms",
            task="wall",
            rng=np.random.default_rng(1),
        ),
        "table must hold two methods or two groups, got one of each",
    ),
    "the same for all": (
        lambda: compare(
            TrialTable.from_rows(
                [row | {"latency_ms": 4.1 + len(row["method"])} for row in rows_of()]
            ),
            "latency_ms",
            task="wall",
            rng=np.random.default_rng(1),
        ),
        "latency_ms must vary among users to be tested, got no variation beside method",
    ),
    "one group": (
        lambda: manova(
            table_of(groups=("a",)),
            ["latency_ms", "force_error"],
            factor="group",
            rng=np.random.default_rng(1),
        ),
        "users must outnumber groups and columns, with two groups or methods",
    ),
    "too many metrics": (
        lambda: manova(
            table_of(users=2), list(DIRECTIONS), factor="method", rng=np.random.default_rng(1)
        ),
        "got 4 users, 2 groups and 12 columns",
    ),
    "a repeated metric": (
        lambda: manova(
            TrialTable.from_rows(
                [row | {"latency_s": 1e-3 * row["latency_ms"]} for row in rows_of()]
            ),
            ["latency_ms", "latency_s"],
            factor="group",
            rng=np.random.default_rng(1),
        ),
        "columns must not be multiples of one another",
    ),
    "index of one user": (
        lambda: composite_index(table_of(**LONE), DIRECTIONS, rng=np.random.default_rng(1)),
        "users must be at least two, got 1",
    ),
    "index of a constant": (
        lambda: composite_index(
            TrialTable.from_rows([row | {"arc_length": 0.1} for row in rows_of()]),
            DIRECTIONS,
            rng=np.random.default_rng(1),
        ),
        "arc_length must vary within a task",
    ),
    "regression on a constant": (
        lambda: regression([1.0, 2.0], {"x": [3.0, 3.0]}, ["a", "b"], response="y"),
        "x must vary, got 3 throughout",
    ),
    "regression on itself": (
        lambda: regression(
            [1.0, 2.0, 4.0],
            {"x": [3.0, 1.0, 2.0], "z": [6.0, 2.0, 4.0]},
            ["a", "b", "b"],
            response="y",
        ),
        "predictors must not repeat one another",
    ),
    "regression of one user": (
        lambda: regression([1.0, 2.0], {"x": [3.0, 1.0]}, ["a", "a"], response="y"),
        "users must be at least two, got 1",
    ),
    "groups of constants": (
        lambda: tukey_groups([[1.0, 1.0], [2.0, 2.0]], "ab", metric="m"),
        "groups must vary within",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_compared_is_reported_in_a_sentence(case):
    call, message = REFUSED[case]
    with pytest.raises(InputError, match=message) as refused:
        call()
    assert ": " in str(refused.value) and "\n" not in str(refused.value)


def test_without_statsmodels_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "statsmodels", None)
    with pytest.raises(InputError, match=r"pip install 'tissue-sim\[study\]'"):
        mixed_model(table_of(), "latency_ms")
