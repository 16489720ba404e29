"""Fits of tables of steady loads on a drill: forward loads, planted constants, rejected laws."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

import tissue
from tissue.fitting.fit import fit_table
from tissue.fitting.laws import REJECTED, MaximumLikelihood, compared_laws, law_sentences
from tissue.fitting.table import SteadyTable, table_forward
from tissue.simulation.load_record import record_loads

LINEAR = {"cutting.size_exponent": 0.0, "cutting.minimum_chip_um": 0.0}
SIZE = {"cutting.size_exponent": 0.3, "cutting.minimum_chip_um": 0.1}
FEEDS_MM_MIN, SPINS_RPM = (
    each.ravel() for each in np.meshgrid([20.0, 40.0, 80.0, 160.0, 320.0], [500.0, 1000.0, 2000.0])
)
SEEDS = 60


def drill(**changes):
    """A block of bone and a 4 mm twist drill."""
    keys = {
        "tool.kind": "twist-drill",
        "tool.diameter_mm": 4.0,
        "tool.length_mm": 30.0,
        "tool.flutes": 2,
        "tool.spin_rpm": 1000.0,
    }
    return tissue.load_scene("milling", keys | changes)


def table_of(scene, feeds_per_turn_m, *, share=None, seed=0):
    """Thrust and torque by a scene's own law, with errors of a share of each load."""
    ones = np.ones((len(feeds_per_turn_m), 2))
    table = SteadyTable(
        Path("table.csv"),
        feeds_per_turn_m,
        ones,
        ones,
        ("force_z_N", "torque_z_Nm"),
    )
    forward = table_forward(scene, table)
    loads = forward.record.loads(forward.coefficients)[:, [2, 5]]
    if share is None:
        return replace(table, loads=loads, scatter=None)
    errors = share * loads * np.random.default_rng(seed).standard_normal(loads.shape)
    return replace(table, loads=loads + errors, scatter=share * loads)


FEEDS_PER_TURN_M = 1e-3 * FEEDS_MM_MIN / SPINS_RPM


def test_loads_of_a_simple_drill_follow_the_closed_form():
    """Thrust (K_rc f sin k + 2 K_re) R and torque K_tc f R2 / 2 + K_te R2 / sin k."""
    scene = drill(**LINEAR, **{"tool.web_mm": 0.0})
    radius = 2e-3
    sine = np.sin(np.radians(59.0))
    feed = FEEDS_PER_TURN_M
    found = table_of(scene, feed).loads
    thrust = (160e6 * feed * sine + 2.0 * 4e3) * radius
    torque = 250e6 * feed * radius**2 / 2.0 + 5e3 * radius**2 / sine
    assert found == pytest.approx(np.column_stack([thrust, torque]), rel=1e-5)


def test_loads_are_those_of_a_plunge_through_voxels():
    changes = {
        "tool.length_mm": 10.0,
        "anatomy.size_mm": [12, 12, 6],
        "voxels.spacing_mm": 0.2,
        "motion.points_mm": [[0, 0, -2.4], [0, 0, -3.0]],
        "motion.feed_mm_s": 1.0,
        "duration_s": 0.5,
    }
    scene = drill(**SIZE, **changes)
    record = record_loads(scene, every=50)
    coefficients = scene.constants.coefficients(
        record.layer_names, scene.cutting.model_dump(exclude={"material"}, exclude_none=True)
    )
    voxels = record.loads(coefficients)[-3:, [2, 5]].mean(axis=0)
    # The drill takes 6e-5 m a turn. Voxels of a twentieth of its diameter leave an error of 1 %.
    assert voxels == pytest.approx(table_of(scene, np.full(2, 6e-5)).loads[0], rel=0.01)


@pytest.fixture(scope="module")
def planted():
    """A table by known coefficients with 2 % of scatter, and its fit."""
    chosen = {"cutting.size_exponent": 0.0, "cutting.minimum_chip_um": 0.0}
    truth = {"tangential_chip_N_mm2": 400.0, "tangential_edge_N_mm": 3.0}
    named = {f"cutting.{name}": value for name, value in truth.items()}
    table = table_of(drill(**chosen, **named), FEEDS_PER_TURN_M, share=0.02)
    return truth, fit_table(drill(**chosen), table)


def test_planted_coefficients_come_back_within_their_intervals(planted):
    truth, fit = planted
    found = {each.name.rpartition(".")[2]: each for each in fit.constants}
    density = found["bone"]
    for name, value in truth.items():
        each = found[name]
        assert each.low < value < each.high
    # Only the product with a power of the density is known: its prior of 10 % remains.
    chip = found["tangential_chip_N_mm2"]
    assert chip.value * density.value**1.5 == pytest.approx(400.0, rel=0.03)
    assert fit.posterior.converged


@pytest.mark.parametrize("law", [LINEAR, SIZE])
def test_the_right_law_is_rejected_in_one_of_twenty_tables(law):
    exact = table_of(drill(**law), FEEDS_PER_TURN_M)
    scatter = 0.05 * exact.loads
    # The exponent is free where the scene states none.
    scene = drill() if law is SIZE else drill(**LINEAR)
    forward = table_forward(scene, replace(exact, scatter=scatter))
    rejected = 0
    for seed in range(SEEDS):
        errors = scatter * np.random.default_rng(seed).standard_normal(scatter.shape)
        table = replace(exact, loads=exact.loads + errors, scatter=scatter)
        fit = MaximumLikelihood(forward, table, has_size_effect=law is SIZE)
        rejected += fit.p < REJECTED
    low, high = binom.interval(0.99, SEEDS, REJECTED)
    assert low <= rejected <= high


def test_the_linear_law_is_rejected_where_a_size_effect_was_planted():
    table = table_of(drill(**SIZE), FEEDS_PER_TURN_M, share=0.02)
    laws = compared_laws(drill(), table)
    assert [each.p < REJECTED for each in laws] == [True, False]
    assert laws[0].cited_p < REJECTED
    assert laws[1].size_exponent == pytest.approx(0.3, abs=0.05)
    assert laws[1].left_out < 0.03 < laws[0].left_out
    sentences = "; ".join(law_sentences(laws))
    assert "linear law: rejected" in sentences and "size effect: not rejected" in sentences


@pytest.mark.parametrize(("law", "has_size_effect"), [(LINEAR, False), ({}, True)])
def test_free_coefficients_fit_both_drills_alike(law, has_size_effect):
    """One fit serves both drills of a law."""
    table = table_of(drill(), FEEDS_PER_TURN_M, share=0.05)
    chisel, simple = (
        MaximumLikelihood(
            table_forward(drill(**law, **web), table), table, has_size_effect=has_size_effect
        )
        for web in ({}, {"tool.web_mm": 0.0})
    )
    assert simple.chi_square == pytest.approx(chisel.chi_square, rel=1e-6)
    assert (simple.freedom, simple.constants) == (chisel.freedom, chisel.constants)
    assert simple.exponent == pytest.approx(chisel.exponent, abs=1e-3)


def test_without_scatter_laws_are_ranked_and_none_is_rejected():
    table = table_of(drill(**SIZE), FEEDS_PER_TURN_M, share=0.02)
    laws = compared_laws(drill(), replace(table, scatter=None))
    assert all(each.p is None and each.cited_p is None for each in laws)
    assert laws[1].aic < laws[0].aic
    (ranking,) = law_sentences(laws)
    assert "rejects no law" in ranking and "law with a size effect comes before" in ranking


def test_a_law_that_fits_every_row_is_not_ranked():
    table = table_of(drill(), FEEDS_PER_TURN_M[:3], share=0.05)
    laws = compared_laws(drill(), replace(table, scatter=None))
    assert laws[0].aic is not None and laws[1].aic is None
    assert "too few to rank" in law_sentences(laws)[0]


TABLE = """spin_rpm,feed_mm_min,thrust_N,thrust_pm_N
1000,120,20.1,1.0
1500,120,17.2,1.0
2000,120,15.9,1.0
"""
SETS = [
    f"--set={pair}"
    for pair in (
        "tool.kind=twist-drill",
        "tool.diameter_mm=4",
        "tool.length_mm=30",
        "tool.flutes=2",
        "tool.spin_rpm=1000",
    )
]


def test_the_command_writes_a_report_of_a_table(here, command):
    (here / "table.csv").write_text(TABLE, "utf-8")
    code, text, problem = command("fit", "milling", *SETS, "--measured", "table.csv", "--out", "f")
    assert code == 0, problem
    assert "linear law: " in text
    found = json.loads((here / "f/fit.json").read_text("utf-8"))
    assert len(found["laws"]) == 2 and "bias" not in found
    report = (here / "f/report.html").read_text("utf-8")
    assert "Which law the table rejects" in report and report.count("<img") == 2
    assert (here / "f/loads.csv").read_text("utf-8").startswith("feed_mm_per_turn,measured_thrust")
    assert tissue.load_scene("milling", {"materials": "f/fitted.toml"})


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("thrust_pm_N", "thrust_sd_N", "thrust_sd_N"),
        ("spin_rpm", "rpm", "rpm"),
        (",feed_mm_min", ",feed_mm_s,feed_mm_min", "table.csv"),
        ("1500,120", "1500,-120", "feed_mm_s, got another value in row 2"),
        ("1500,120", "1500,", "another value in row 2"),
        ("1500,120", "1500,fast", "'fast'"),
        ("1500,120,17.2,1.0\n2000,120,15.9,1.0\n", "", "1 row"),
        ("thrust_N,thrust_pm_N", "thrust_N,torque_pm_Nmm", "torque_pm_Nmm"),
        ("feed_mm_min", "feed_mm_s", "drill's radius"),
    ],
)
def test_tables_that_cannot_be_used_are_refused(here, refused, old, new, named):
    assert old in TABLE
    (here / "table.csv").write_text(TABLE.replace(old, new), "utf-8")
    assert named in refused("fit", "milling", *SETS, "--measured", "table.csv")


def test_other_tools_bones_and_names_are_refused(here, refused):
    (here / "table.csv").write_text(TABLE, "utf-8")
    assert "tool.kind" in refused("fit", "milling", "--measured", "table.csv")
    assert "anatomy.kind" in refused("fit", "pedicle", "--measured", "table.csv")
    maps = "--column", "thrust_N=F"
    assert "column" in refused("fit", "milling", *SETS, "--measured", "table.csv", *maps)
