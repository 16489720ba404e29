"""The table of trials, the composite index, and one sentence for whatever cannot be compared."""

import csv

import numpy as np
import pytest

from tissue.evaluation.statistics.hpi import composite_index, weights_of
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


def test_an_index_orders_what_was_planted():
    found = composite_index(table_of(users=10), DIRECTIONS, rng=np.random.default_rng(5))
    assert sum(each.value for each in found.weights) == pytest.approx(1.0, abs=1e-12)
    assert all(each.low <= each.value <= each.high for each in found.weights)
    means = {each.name: each.value for each in found.means}
    # the order they were planted in
    assert means["energy"] < means["koopman"] < means["penalty"] < means["perception"]
    assert all(each.holds for each in found.assumptions) and min(found.loadings) > 0.0
    assert np.nanmean(found.values) == pytest.approx(0.0, abs=1e-12)
