"""The law that a demanded fidelity needs, by how deep a ball is pressed."""

import pytest

from tissue.evaluation.charts.law import linear_error, with_law
from tissue.scene.coupling import Fidelity
from tissue.scene.load import load_scene

PRESS = {
    "anatomy.size_mm": [50, 50, 30],
    "anatomy.edge_mm": 10.0,
    "anatomy.touch_edge_mm": 6.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "organ.parts": None,
    "organ.young_kPa": 5.0,
    "organ.young_end_kPa": None,
    "organ.poisson_ratio": 0.45,
    "organ.interval_ms": 0.0,
    "organ.order": 1,
    "tool.diameter_mm": 16.0,
    "motion.points_mm": [[0, 0, 0.2], [0, 0, -4.6]],
    "motion.feed_mm_s": 20.0,
}
"""0.57 of the ball's radius deep: 10 % by the chart."""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    return load_scene("palpation", PRESS)


def test_the_error_of_the_linear_law_grows_with_the_depth():
    assert [linear_error(depth) for depth in (0.0, 0.185, 0.37, 0.57, 0.77)] == pytest.approx(
        [0.0, 0.025, 0.05, 0.1, 0.15]
    )


def test_a_law_is_taken_where_the_linear_one_is_too_far_off(scene):
    same, why = with_law(scene, Fidelity(force_error=0.12))
    assert same.organ.law == "linear" and "linear law, 10 % off" in why
    other, why = with_law(scene, Fidelity(force_error=0.05))
    assert (
        other.organ.law == "neo-hookean" and "for the linear one is 10 % off 0.57 radii deep" in why
    )
    assert with_law(scene, Fidelity(tick_ms=0.5)) == (scene, "")
