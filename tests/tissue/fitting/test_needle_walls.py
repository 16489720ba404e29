"""Several membranes in a needle's law: forces shared or stated, derivatives, and a fit of stated ones."""

import numpy as np
import pytest

import tissue
from tissue.fitting.needle import NeedleForward, needle_names
from tissue.fitting.needle_walls import CITED, stated_forces, walls_of
from tissue.fitting.parameter import Parameter
from tissue.materials.constants import constants
from tissue.materials.prior import Prior
from tissue.models.needle.insertion import Insertion
from tissue.models.needle.parameters import needle_tissue, vessel_wall

STEP_S, FEED_M_S = 4e-3, 0.01
FORCES = {"membrane_punctures_N": {"far": 1.2}, "membrane_holds_N": {"far": 0.5, "near": 0.0}}
SCENE = {
    "anatomy.interval_ms": 0.0,
    "anatomy.membrane_depths_mm": {"far": 28.0, "near": 12.0, "middle": 20.0},
    **{f"anatomy.{key}": forces for key, forces in FORCES.items()},
}
FAR = ("anatomy.membrane_punctures_N.far", "anatomy.membrane_holds_N.far")


@pytest.fixture(scope="module")
def forward():
    """The law of a scene with three membranes along a push, with the events of the engine's own law."""
    anatomy = tissue.load_scene("needle", SCENE).anatomy
    walls, (stated, free) = walls_of(anatomy), stated_forces(anatomy)
    cited = {
        name: constants(*name.split(".")[:2])[name.split(".")[2]] for name in needle_names(walls) if name not in stated
    }
    travel = np.arange(-0.002, 0.06, STEP_S * FEED_M_S)
    plain = NeedleForward(
        (*(Parameter(name, Prior.of(entry, name)) for name, entry in cited.items()), *free),
        {name: entry.value for name, entry in cited.items()} | stated,
        STEP_S * np.arange(len(travel)), travel, walls=walls,
    )  # fmt: skip
    events = plain.expected_events()
    assert [each.kind for each in events].count("puncture") == 4
    return NeedleForward(
        plain.parameters, plain.known, plain.times_s, travel, walls=walls,
        events=events,
    )  # fmt: skip


def known(forward):
    return np.array([forward.known[each.name] for each in forward.parameters])


def test_membranes_are_sorted_and_what_is_not_stated_is_cited(forward):
    assert [each.depth_m for each in forward.walls] == pytest.approx([0.012, 0.020, 0.028])
    assert [(each.puncture, each.hold) for each in forward.walls] == [
        (CITED[0], "anatomy.membrane_holds_N.near"), CITED, FAR,
    ]  # fmt: skip
    assert {each.name for each in forward.parameters} >= {*CITED, *FAR}
    assert "anatomy.membrane_holds_N.near" not in {each.name for each in forward.parameters}, "0 has no range"


def test_loads_are_those_of_the_law_itself(forward):
    walls = [
        vessel_wall(0.012, name="near", hold_N=0.0), vessel_wall(0.020, name="middle"),
        vessel_wall(0.028, name="far", puncture_N=1.2, hold_N=0.5),
    ]  # fmt: skip
    insertion, force = Insertion(needle_tissue(walls=walls), travel_m=forward.travel_m[0]), [0.0]
    for travel in forward.travel_m[1:].tolist():
        insertion.advance(travel, FEED_M_S)
        force.append(insertion.pull_N + insertion.drag_N_s_m * FEED_M_S)
    assert insertion.punctured == 4
    loads = forward.loads(known(forward))[:, 0]
    assert np.abs(loads - force).max() < np.abs(np.diff(force)[np.diff(force) > 0.0]).max()


def test_derivatives_by_differences(forward):
    x = known(forward) * (1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, len(forward.parameters)))
    slopes = forward.jacobian(x)
    moving = 0
    for at in range(len(x)):
        moved = np.zeros(len(x))
        moved[at] = 1e-5 * x[at]
        by = (forward.loads(x + moved) - forward.loads(x - moved)) / (2e-5 * x[at])
        np.testing.assert_allclose(slopes[:, :, at], by, atol=1e-5 * np.abs(by).max() + 1e-9)
        moving += bool(np.abs(by).max() > 0.0)
    assert moving >= 8, "a push alone leaves what acts outwards and at rest unknown"


@pytest.mark.slow
def test_forces_of_membranes_come_back(tmp_path):
    """Puncture and hold of the last of two, planted 1.5 and 0.7 times what the scene states."""
    changes = {
        "anatomy.interval_ms": 0.0, "anatomy.membrane_depths_mm": {"near": 15.0, "far": 30.0},
        "anatomy.membrane_punctures_N": {"far": 2.4}, "anatomy.membrane_holds_N": {"far": 0.35},
        "motion.points_mm": [[0, 0, 5], [0, 0, -70]], "motion.feed_mm_s": 10.0, "duration_s": None,
    }  # fmt: skip
    table = tissue.simulate(tissue.load_scene("needle", changes)).to_pandas()
    kept = table[["time_s", *(f"tool_{c}_mm" for c in "xyz"), *(f"tool_q{c}" for c in "xyzw")]].copy()
    kept["force_z_N"] = table["model_force_z_N"] + 0.02 * np.random.default_rng(5).standard_t(4, size=len(table))
    kept.to_csv(tmp_path / "log.csv", index=False)
    stated = {"anatomy.membrane_punctures_N": {"far": 1.6}, "anatomy.membrane_holds_N": {"far": 0.5}}
    fit = tissue.fit(tissue.load_scene("needle", changes | stated), tmp_path / "log.csv")
    rows = fit.to_pandas()
    print(rows[["p05", "p50", "p95", "state"]])
    for name, planted in zip(FAR, (2.4, 0.35), strict=True):
        row = rows.loc[name]
        assert row["state"] == "determined", name
        assert abs(row["p50"] - planted) < 4.0 * (row["p95"] - row["p05"]) / 3.29, name
    fit.save(tmp_path / "fit")
    assert "membrane" not in (tmp_path / "fit" / "fitted.toml").read_text("utf-8")
