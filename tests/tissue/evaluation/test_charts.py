"""Frontiers, costs and the choice by fidelity."""

import csv

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.evaluation.charts import frontier as module
from tissue.evaluation.charts.frontier import (
    SAFETY,
    choose,
    frontier_of,
    undominated,
    with_fidelity,
    write_measured,
)
from tissue.evaluation.charts.measure import Measured, measure
from tissue.evaluation.charts.settings import (
    Setting,
    by_hand,
    finest,
    placed,
    settings_of,
)
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed, load_scene, scene_names

COARSE = {"voxels.spacing_mm": 0.2, "anatomy.size_mm": [12, 10, 4], "motion.feed_mm_s": 20.0}


def point(name="a", *, error=0.1, median=100.0, p99=200.0, family="voxels"):
    return Measured(
        scene="block",
        setting=name,
        family=family,
        force_error=error,
        error_50_ms=0.7 * error,
        median_us=median,
        p99_us=p99,
        missed=0,
        machine="here",
    )


def test_the_frontier_is_what_nothing_beats():
    rng = np.random.default_rng(0)
    points = [
        point(str(i), error=e, median=m)
        for i, (e, m) in enumerate(rng.uniform(0.01, 1.0, (200, 2)))
    ]
    best = undominated(points)
    assert 2 < len(best) < 50
    for one in best:
        assert not any(
            other.median_us < one.median_us and other.force_error < one.force_error
            for other in points
        )
    for other in set(points) - set(best):
        assert any(
            one.median_us <= other.median_us and one.force_error <= other.force_error
            for one in best
        )


def test_the_cheapest_that_is_good_enough_is_chosen():
    points = [
        point("coarse", error=0.2, median=10),
        point("middle", error=0.03, median=50),
        point("fine", error=0.01),
    ]
    assert choose(points, Fidelity(force_error=0.2 * SAFETY)).setting == "coarse"
    assert choose(points, Fidelity(force_error=0.031 * SAFETY)).setting == "middle"
    assert choose(points, Fidelity(tick_ms=0.5)).setting == "fine"
    with pytest.raises(InputError, match="nearest setting reaches: fine"):
        choose(points, Fidelity(force_error=1e-3))
    with pytest.raises(InputError, match="fidelity"):
        load_scene("milling", {"fidelity": {}})


def test_a_table_of_measurements_has_all_digits(tmp_path):
    points = [point("a", error=0.1 + 1e-17), point("b, and a comma", median=1 / 3)]
    write_measured(tmp_path / "a.csv", points)
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["setting"] for row in rows] == ["a", "b, and a comma"]
    assert float(rows[0]["force_error"]) == 0.1 + 1e-17 and float(rows[1]["median_us"]) == 1 / 3


@pytest.mark.parametrize("name", scene_names())
@pytest.mark.parametrize("hand", [False, True])
def test_every_setting_of_every_scene_is_a_valid_scene(name, hand):
    scene = load_scene(name)
    scene = by_hand(scene) if hand else changed(scene, {"device": "none"})
    for quick in (True, False):
        settings = settings_of(scene, quick=quick)
        assert len({setting.name for setting in settings}) == len(settings) >= 1
        assert len({repr(each.changes) for each in settings}) == len(settings)
        for setting in settings:
            changed(scene, setting.changes)
        changed(scene, finest(scene, quick=quick))


def cutting(scene, **changes):
    """Return the settings of simpler laws and drills of a scene, by name."""
    found = settings_of(changed(load_scene(scene), changes), quick=True)
    return {each.name: each.changes for each in found if each.family == "cutting"}


LINEAR = {"cutting.size_exponent": 0.0, "cutting.minimum_chip_um": 0.0}
SIMPLE = {"tool.web_mm": 0.0}


def test_each_refinement_of_law_and_drill_is_left_out_once_and_all_on_the_coarsest_grid():
    found = cutting("pedicle")
    assert list(found) == ["0.1 mm, linear law", "0.1 mm, simple drill", "0.4 mm, simplest"]
    assert found["0.1 mm, linear law"] == LINEAR and found["0.1 mm, simple drill"] == SIMPLE
    assert (LINEAR | SIMPLE).items() <= found["0.4 mm, simplest"].items()
    assert found["0.4 mm, simplest"]["voxels.spacing_mm"] == 0.4
    sized = cutting("pedicle", **{"cutting.size_exponent": 0.3})
    assert sized["0.1 mm, no size effect"] == {"cutting.size_exponent": 0.0}
    assert list(sized)[1:] == list(found)
    assert not cutting("pedicle", **LINEAR, **SIMPLE)
    assert list(cutting("molar")) == ["0.05 mm, linear law", "0.2 mm, simplest"]


@pytest.fixture
def block(monkeypatch, tmp_path):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    return load_scene("milling", COARSE)


@pytest.mark.slow
def test_a_finished_chart_is_not_measured_again_and_a_fidelity_chooses_from_it(block, monkeypatch):
    settings = [
        Setting("0.4 mm", "voxels", {"voxels.spacing_mm": 0.4, "tool.shell_spacing_mm": 0.6}),
        Setting("0.2 mm", "voxels"),
    ]
    monkeypatch.setattr("tissue.evaluation.charts.measure.EXCERPT_S", {True: 0.4})
    monkeypatch.setattr(
        "tissue.evaluation.charts.frontier.settings_of", lambda scene, quick: settings
    )
    found = frontier_of(block)
    coarse, fine = found.points
    assert coarse.force_error > 2.0 * fine.force_error > 0.0
    assert found.gap > 0.0
    with monkeypatch.context() as measured:
        measured.setattr(module, "measure", lambda *given, **more: pytest.fail("measured again"))
        frontier_of(block)
    wanted = changed(block, {"fidelity": {"force_error": 1.01 * SAFETY * coarse.force_error}})
    chosen, message = with_fidelity(wanted)
    assert chosen.fidelity is None and chosen.voxels.spacing_mm in (0.2, 0.4)
    assert "the cheapest setting that meets force_error" in message
    assert ", of 2 measured settings: " in message
    run = tissue.simulate(wanted.model_copy(update={"duration_s": 0.01}))
    assert run.parts.notes["fidelity"] and run.scene.fidelity is None


@pytest.mark.slow
def test_the_error_of_the_linear_law_is_against_the_refined_one(block):
    """A chip of 20 um at most and h_min = 10 um: the edge force at thin chips is the error."""
    block = changed(block, {"cutting.minimum_chip_um": 10.0, "duration_s": 0.5})
    linear = next(each for each in settings_of(block, quick=True) if "linear" in each.name)
    refined, simple = (measure(block, each, quick=True) for each in (Setting("a", "a"), linear))
    assert refined.force_error < 0.05 < 0.3 < simple.force_error


def test_places_keep_a_peg_in_its_hole_and_leave_hands_alone(block):
    glenoid, given_mm = load_scene("glenoid"), np.array(load_scene("glenoid").motion.points_mm)
    assert [each.motion for each in placed(by_hand(block))] == [block.motion]
    for scene in placed(glenoid)[1:]:
        away = np.array(scene.motion.points_mm) - given_mm
        assert 0.0 < np.abs(away[:, :2]).max() <= 0.5 * glenoid.voxels.spacing_mm
        assert (
            scene.motion.points_mm[-1][2] != given_mm[-1, 2]
            and scene.motion.points_mm[0][2] == given_mm[0, 2]
        )
    assert placed(block)[0] is block and len({scene.motion for scene in placed(block)}) == 3
