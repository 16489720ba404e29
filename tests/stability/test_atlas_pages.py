"""Every page of the atlas on its quick sweep: its verdict, the engine's answers, and that spoilt data spoil the verdict."""

import numpy as np
import pytest

from tissue.evaluation.atlas.atlas import write_atlas
from tissue.evaluation.atlas.page import Conduct
from tissue.evaluation.atlas.pages import PAGES

HEAVY = {"large_rotation", "sampled_wall", "wall_map", "horizon", "trained_elsewhere", "cut_cells", "nearest_point"}
"""Pages that take about a second and more."""
SPOILT = {
    "one_step_order": ("closed", "exact", "printed"),
    "powers": ("horizon", "capped", "free"),
    "low_pass": ("step", "exact_error", "explicit_error"),
    "pade": ("damped", "exact_N_m", "pade_N_m"),
    "force_command": ("dull", "felt_ours", "felt_printed"),
    "weber_law": ("negative", "ours_share", "printed_share"),
    "two_maxima": ("seen", "ours_N", "newton_N"),
    "recursive_variance": ("variance", "ours_error", "printed_error"),
    "damper_sign": ("cycle", "ours_J", "printed_J"),
    "sampled_wall": ("leak", "supervised_J", "hold_J"),
    "relaxation": ("bound", "measured", None),
    "nearest_point": ("way", "ours_m", "nearest_m"),
    "smoothness": ("tremor", "arc_length", "printed_m_s2"),
    "index_weights": ("unit", "ours_position_error", "printed_position_error"),
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
"""Table, the engine's own column, and the column of what fails; None: the own column turned round."""


def test_every_page_is_here_once():
    names = [page.name for page in PAGES]
    assert len(set(names)) == len(names) == len(SPOILT) == 27
    assert set(names) == set(SPOILT) and set(names) >= HEAVY
    titles = " ".join(page.title for page in PAGES)
    assert all(f"E{number} ·" in titles for number in range(1, 15))


RIGHTED = {
    "one_step_order": ("linear", {"printed": "quadratic"}),
    "force_command": ("dull", {"printed_in_tenths_N": "printed_N"}),
    "recursive_variance": ("variance", {"printed_error": "printed_believed"}),
    "nearest_point": ("thickness", {"nearest_pops_at_m": "ours_held_to_m"}),
    "index_weights": (
        "unit",
        {f"printed_{name}": f"ours_{name}" for name in ("accuracy", "force_error", "position_error", "time_s")},
    ),
    "wall_map": ("delay", {"first_order_N_m": "exact_N_m", "pade_N_m": "exact_N_m"}),
}
"""Columns of what fails and what it would be were it right, where the engine's own column is not enough."""


def replaced(data, table, columns):
    """The data with columns of a table replaced by others of it; None: turned round."""
    old = data[table]
    new = {name: -old[name] if other is None else old[other] for name, other in columns.items()}
    return data | {table: old | new}


@pytest.mark.parametrize(
    "page",
    [pytest.param(each, id=each.name, marks=[pytest.mark.slow] if each.name in HEAVY else []) for each in PAGES],
)
def test_a_page_shows_its_boundary_and_how_the_engine_behaves(page):
    data = page.measure(True)
    verdict, answers = page.judge(data), page.ask()
    assert verdict.fails, verdict.sentence
    assert verdict.holds, verdict.sentence
    assert not [answer for answer in answers if answer.conduct is Conduct.SILENT] and len(answers) >= 2
    assert "nan" not in verdict.sentence and any(letter.isdigit() for letter in verdict.sentence)
    for table in data.values():
        assert len({len(values) for values in table.values()}) == 1
        assert all(np.asarray(values).dtype == float for values in table.values())
    # Were the engine as wrong as the method in question, or that one as right as the engine, the page would report it.
    table, ours, failing = SPOILT[page.name]
    righted = RIGHTED.get(page.name, (table, {failing: ours}))
    with np.errstate(all="ignore"):
        assert not page.judge(replaced(data, table, {ours: failing})).holds
        assert failing is None or not page.judge(replaced(data, *righted)).fails


@pytest.mark.slow
def test_the_whole_atlas_shows_every_boundary(tmp_path):
    """The full sweeps, as `tissue stability` makes them."""
    entries = write_atlas(tmp_path, PAGES)
    assert [entry.page.name for entry in entries if not entry.shown] == []
    html = (tmp_path / "index.html").read_text("utf-8")
    assert html.count("<section") == html.count("data:image/png;base64,") == len(PAGES)
    for entry in entries:
        assert entry.picture.startswith(b"\x89PNG") and len(entry.picture) > 20_000
        assert entry.files and all((tmp_path / name).stat().st_size > 0 for name in entry.files)
