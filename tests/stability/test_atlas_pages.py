"""Pages of the atlas.

Checked are the verdict, and verdicts of spoilt data.
"""

import numpy as np
import pytest

from tissue.evaluation.atlas import PAGES, held_tool
from tissue.evaluation.atlas.page import picture

HEAVY = {each.name for each in PAGES} - {"wild_input", "explicit_cutting", "bad_tetrahedra"}
"""Pages that take about a second and more."""
SPOILT = {
    "wall_map": ("exact_N_m", "first_order_N_m"),
    "quantisation": ("bound_N_m", "critical_N_m"),
    "explicit_cutting": ("implicit", "explicit"),
    "thin_walls": ("end_m", None),
    "locking": ("quadratic_m", "linear_coarse_m"),
    "large_rotation": ("neo_hookean_pa", "linear_pa"),
    "bad_tetrahedra": ("repaired_condition", "condition"),
    "cut_cells": ("scaled", "bare_scaled"),
    "contrast": ("multigrid_8", "plain"),
    "held_tool": ("engine", "massless"),
    "trained_elsewhere": ("guarded", "bare"),
    "horizon": ("koopman", "kalman"),
    "lost_samples": ("guarded_at_end", "bare_at_end"),
    "wild_input": ("guarded_N", "bare_N"),
}
"""Column of the engine and column of the failing method.

None stands for the column of the engine, negated.
"""


HELD = ("molar",)
"""Scenes of the page on held tools that are replayed here.

In ``molar`` the massless limit amplifies a shift 23 times. It amplifies at most 3.7 times elsewhere.
`tissue stability` replays all five scenes.
"""


def marks(page):
    """Marks of the test of a page."""
    return [pytest.mark.slow] if page.name in HEAVY else []


def replaced(data, columns):
    """Return the data with columns replaced by others of their table; None: negated."""
    return {
        name: table
        | {
            column: -table[column] if other is None else table[other]
            for column, other in columns.items()
            if column in table
        }
        for name, table in data.items()
    }


# The page on held tools has a single shift here. Its x axis then has no extent.
@pytest.mark.filterwarnings("ignore:Attempting to set identical low and high xlims")
@pytest.mark.parametrize(
    "page",
    [pytest.param(each, id=each.name, marks=marks(each)) for each in PAGES],
)
def test_a_page_shows_its_boundary(page, monkeypatch):
    monkeypatch.setattr(held_tool, "SECONDS", {name: held_tool.SECONDS[name] for name in HELD})
    monkeypatch.setattr(held_tool, "STYLES", held_tool.STYLES[: len(HELD)])
    monkeypatch.setattr(held_tool, "SHIFTS_M", held_tool.SHIFTS_M[:1])
    data = page.measure()
    verdict = page.judge(data)
    assert verdict.fails, verdict.sentence
    assert verdict.holds, verdict.sentence
    assert "nan" not in verdict.sentence and any(letter.isdigit() for letter in verdict.sentence)
    for table in data.values():
        assert len({len(values) for values in table.values()}) == 1
        assert all(np.asarray(values).dtype == float for values in table.values())
    assert len(picture(page, data)) > 20_000
    # Were the engine as wrong as the method in question, or that one as right as the engine, the
    # page would report it.
    engine, failing = SPOILT[page.name]
    righted = {failing: engine}
    if page.name == "wall_map":
        righted["pade_N_m"] = engine
    with np.errstate(all="ignore"):
        assert not page.judge(replaced(data, {engine: failing})).holds
        assert failing is None or not page.judge(replaced(data, righted)).fails
