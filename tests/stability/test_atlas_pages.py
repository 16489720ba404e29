"""Pages of the atlas on their quick sweeps.

Checked are the verdict, the answers of the engine, and verdicts of spoilt data.
"""

import numpy as np
import pytest

from tissue.evaluation.atlas.atlas import PAGES
from tissue.evaluation.atlas.page import Conduct

HEAVY = {"large_rotation", "wall_map", "horizon", "trained_elsewhere", "cut_cells"}
"""Pages that take about a second and more."""
SPOILT = {
    "wall_map": ("delay", "exact_N_m", "first_order_N_m"),
    "quantisation": ("friction", "bound_N_m", "critical_N_m"),
    "explicit_cutting": ("step", "implicit", "explicit"),
    "thin_walls": ("proxy", "end_m", None),
    "locking": ("bar", "quadratic_m", "linear_coarse_m"),
    "large_rotation": ("turn", "corotational_pa", "linear_pa"),
    "bad_tetrahedra": ("sliver", "repaired_condition", "condition"),
    "cut_cells": ("fill", "scaled", "bare_scaled"),
    "contrast": ("contrast", "multigrid_8", "plain"),
    "trained_elsewhere": ("wall", "guarded", "bare"),
    "horizon": ("horizon", "koopman", "kalman"),
    "lost_samples": ("duplicated", "guarded_at_end", "bare_at_end"),
    "wild_input": ("jump", "guarded_N", "bare_N"),
}
"""Table, the column of the engine and the column of the failing method.

None stands for the column of the engine, negated.
"""
RIGHTED = {"wall_map": ("delay", {"first_order_N_m": "exact_N_m", "pade_N_m": "exact_N_m"})}
"""Columns of failing methods, and right columns that replace them.

They are needed where the column of the engine is not enough.
"""


def replaced(data, table, columns):
    """Return the data with columns of a table replaced by others of it; None: negated."""
    old = data[table]
    new = {name: -old[name] if other is None else old[other] for name, other in columns.items()}
    return data | {table: old | new}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(each, id=each.name, marks=[pytest.mark.slow] if each.name in HEAVY else [])
        for each in PAGES
    ],
)
def test_a_page_shows_its_boundary_and_how_the_engine_behaves(page):
    data = page.measure(True)
    verdict, answers = page.judge(data), page.ask()
    assert verdict.fails, verdict.sentence
    assert verdict.holds, verdict.sentence
    assert (
        not [answer for answer in answers if answer.conduct is Conduct.SILENT] and len(answers) >= 2
    )
    assert "nan" not in verdict.sentence and any(letter.isdigit() for letter in verdict.sentence)
    for table in data.values():
        assert len({len(values) for values in table.values()}) == 1
        assert all(np.asarray(values).dtype == float for values in table.values())
    # Were the engine as wrong as the method in question, or that one as right as the engine, the
    # page would report it.
    table, engine, failing = SPOILT[page.name]
    righted = RIGHTED.get(page.name, (table, {failing: engine}))
    with np.errstate(all="ignore"):
        assert not page.judge(replaced(data, table, {engine: failing})).holds
        assert failing is None or not page.judge(replaced(data, *righted)).fails
