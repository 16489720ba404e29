"""Bone with a temperature: trace, summary, thermal dose and events."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue import load_scene
from tissue.fitting.bands.sample_loads import figures_of
from tissue.models.bone.model import BoneModel
from tissue.models.heat.bone import BODY_C, HeatedBone, dose_rate
from tissue.scene.used_constants import used_constants
from tissue.show.report.page import run_rows
from tissue.simulation.findings import largest_rise
from tissue.simulation.simulate import simulate
from tissue.simulation.trace import Table

CHANGES = {
    "anatomy.size_mm": [8.0, 8.0, 4.0],
    "tool.diameter_mm": 2.0,
    "tool.shell_spacing_mm": 0.2,
    "voxels.spacing_mm": 0.25,
    "motion.points_mm": [[0.0, 0.0, 0.1], [0.0, 0.0, -1.0], [2.0, 0.0, -1.0]],
    "motion.feed_mm_s": 5.0,
    "duration_s": 0.75,
}


@pytest.fixture(scope="module")
def runs():
    """A short milling run without and with heat."""
    return [simulate(load_scene("milling", CHANGES | {"heat": heat})) for heat in (False, True)]


def test_heat_adds_a_column_and_changes_no_other(runs):
    plain, warmed = runs
    assert type(plain.parts.tissue) is BoneModel
    assert set(warmed.trace.columns) - set(plain.trace.columns) == {"bone_rise_K"}
    for name in plain.trace.columns:
        np.testing.assert_array_equal(plain.trace[name], warmed.trace[name], err_msg=name)
    assert "bone_heat" not in plain.summary
    assert warmed.trace["bone_rise_K"].max() > 1.0


def test_summary_holds_the_balance_and_the_figures_of_the_remaining_bone(runs):
    summary = runs[1].summary
    balance = summary["heat_J"]
    assert set(balance) == {"cutting", "with_chips_and_spray", "with_removed_bone", "left_in_bone"}
    parts = sum(value for name, value in balance.items() if name != "cutting")
    assert parts == pytest.approx(balance["cutting"], rel=1e-5)
    figures = summary["bone_heat"]
    assert figures["largest_rise_K"] > figures["rise_at_half_mm_K"] > 0.0
    assert figures_of(runs[1])["bone_heat", "largest_rise_K"] == figures["largest_rise_K"]
    peak = runs[1].parts.tissue.peak_K
    assert figures["largest_rise_K"] <= peak.max()


def test_summary_and_table_hold_the_largest_rise_and_its_time(runs):
    plain, warmed = runs
    assert "largest_rise" not in plain.summary
    column = warmed.trace["bone_rise_K"]
    time_s = warmed.trace["time_s"][column.argmax()]
    is_rising = bool(time_s > warmed.trace["time_s"][-1] - 0.1)
    assert warmed.summary["largest_rise"] == {
        "tissue": "bone",
        "rise_K": column.max(),
        "time_s": time_s,
        "rising_at_end": is_rising,
    }
    row = dict(run_rows(warmed.summary))["largest temperature rise of the bone"]
    assert row.startswith(f"{column.max():.2f} K at {time_s:.3g} s")


@pytest.mark.parametrize(
    ("rises_K", "rising"),
    [(np.linspace(0.0, 3.2, 500), True), (np.r_[:250, 250:0:-1], False), (np.zeros(500), False)],
)
def test_a_rise_at_the_end_is_marked(runs, rises_K, rising):
    names = ("time_s", "pulp_rise_K")
    table = Table(names, np.column_stack([1e-3 * np.arange(500), rises_K]), ())
    found = largest_rise(table)
    assert (found["tissue"], found["rising_at_end"]) == ("pulp", rising)
    row = dict(run_rows(runs[0].summary | {"largest_rise": found}))
    assert row["largest temperature rise of the pulp"].endswith("at the end") == rising


def test_the_limit_of_the_pulp_is_reported_once():
    coarse = {"voxels.spacing_mm": 0.25, "stress": None, "heat": True, "duration_s": 0.01}
    tooth = simulate(load_scene("molar", coarse)).parts.tissue
    tooth.notices.clear()
    for rise_K in (5.4, 5.6, 5.4, 5.6, 4.0, 6.0):
        tooth._see_pulp(SimpleNamespace(pulp_rise_K=rise_K))
    assert tooth.notices == ["the pulp is 5.5 K warmer than at the start"]


def test_bone_uses_the_thermal_constants_of_bone():
    scene = load_scene("milling", {"heat": True})
    names = {each.full for each in used_constants(scene, ("cortical", "trabecular"))}
    thermal = {"conductivity_W_mK", "heat_capacity_J_kgK", "density_kg_m3"}
    expected = {f"tooth.bone.{name}" for name in thermal} | {"tooth.bur.heat_share"}
    assert {name for name in names if name.startswith("tooth.")} == expected


@pytest.mark.parametrize(
    ("temperature_C", "seconds", "dose_min"),
    [(47.0, 60.0, 16.0), (43.0, 60.0, 1.0), (42.0, 60.0, 0.25), (56.0, 7.5, 1024.0)],
)
def test_thermal_dose(temperature_C, seconds, dose_min):
    assert seconds / 60.0 * dose_rate(np.array(temperature_C)) == pytest.approx(dose_min)


@pytest.fixture
def bone():
    """Bone under a tool that has hardly cut."""
    scene = load_scene("milling", CHANGES | {"heat": True, "duration_s": 0.02})
    found = simulate(scene).parts.tissue
    assert isinstance(found, HeatedBone)
    found.notices.clear()
    found.dose_min[:] = 0.0
    return found


def keep_warm(bone, temperature_C, seconds):
    """Keep the whole bone at a temperature."""
    field = bone.heat.field
    rise = np.where(field.filled > 0.0, temperature_C - BODY_C, 0.0).astype(np.float32)
    for each in field._temperature:
        each.assign(rise)
    field.advance(np.zeros(field.filled.shape), seconds)
    bone.finish()


def test_each_limit_of_the_dose_is_one_event(bone):
    """16 and 240 min at 43 degC take 0.94 and 14.1 s at 53 degC."""
    keep_warm(bone, 53.0, 0.9)
    assert bone.dose_min.max() == pytest.approx(1024.0 * 0.9 / 60.0, rel=1e-4)
    assert not bone.notices
    keep_warm(bone, 53.0, 0.1)
    assert len(bone.notices) == 1
    assert "passes 16 min at 43" in bone.notices[0]
    keep_warm(bone, 57.0, 1.0)
    assert len(bone.notices) == 2
    assert "passes 240 min at 43" in bone.notices[1]
    keep_warm(bone, 57.0, 0.1)
    assert len(bone.notices) == 2
    left_mm3 = 1e9 * float((bone.heat.field.filled * bone.heat.grid.volumes_m3).sum())
    assert bone.summary()["bone_heat"]["dose_240_min_mm3"] == pytest.approx(left_mm3)


def test_bone_in_front_of_the_tool_raises_no_event(bone):
    """The tool is about to remove this bone."""
    points = np.array([[-1e-3, -1e-3, -1e-3], [1e-3, 1e-3, 0.0]])
    bone.heat._later = points, np.zeros((2, 3)), np.ones(2)
    behind = bone._is_behind()
    near = (np.abs(bone._centres_m[..., :2]) < 1.9e-3).all(axis=-1)
    near &= bone._centres_m[..., 2] > -1.9e-3
    assert near.any()
    assert not behind[near].any()
    assert behind[np.abs(bone._centres_m[..., 0]) > 2.1e-3].any()
    bone.heat._later = points, np.zeros((2, 3)), np.zeros(2)
    np.testing.assert_array_equal(bone._is_behind(), bone.heat.field.filled > 0.0)
