"""Pictures of a soft organ at different instants, and runs of which a picture fails."""

import json

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.objects.overlay import Curve, overlay
from tissue.show.figures import draw_pictures, force_depth, organ_pictures
from tissue.show.report.page import run_rows

pytest.importorskip("pyvista")


@pytest.mark.parametrize("depth_mm", [17.0, 65.0])
def test_press_of_a_needle_has_a_colour_for_each_point(depth_mm, tmp_path, monkeypatch):
    """A needle that is 65 mm deep is not clipped above the organ, so its end has sharp edges."""
    points = [[0.0, 0.0, 1.0], [0.0, 0.0, -depth_mm]]
    changes = {"motion.points_mm": points, "motion.feed_mm_s": 100.0, "anatomy.interval_ms": 60.0}
    run = simulate(load_scene("needle", changes))
    made = []
    monkeypatch.setattr(
        organ_pictures, "draw_shaded", lambda make, *_, **__: made.extend(make()) or None
    )
    assert organ_pictures.draw_press(run, tmp_path / "press.png") is None
    for surface, _ in made:
        assert len(surface.point_data["colours"]) == surface.n_points


TOP_MM = (2.5, 0.0, 4.3301)
DEEP_MM = (-15.0, 0.0, -25.9808)
ALONG = (0.5, 0.0, 0.8660254)
"""Path of a needle at 30 degrees to the vertical, and its direction from tip to shank."""


def oblique_run(**changes):
    """Run of a needle along an oblique path."""
    path = {"motion.points_mm": [TOP_MM, DEEP_MM], "motion.feed_mm_s": 100.0}
    return simulate(load_scene("needle", path | changes))


def test_insertion_of_an_oblique_needle_shows_the_force_along_its_axis(tmp_path, monkeypatch):
    charts = []
    monkeypatch.setattr(force_depth, "save", lambda chart, path: charts.append(chart))
    run = oblique_run(**{"motion.axis": ALONG, "anatomy.interval_ms": 0.0})
    force_depth.draw_insertion(run, tmp_path / "insertion.png")
    lines = {line.get_label(): line.get_ydata() for line in charts[0].axes[1].lines}
    parts = sum(run.trace[name] for name in ("elastic_N", "cutting_N", "friction_N"))
    np.testing.assert_allclose(lines["all together"], parts, atol=1e-9)
    assert parts.max() > 1.0 and "axis" not in run.parts.notes
    # The depth is the travel along the needle, as in the event of the puncture.
    travel_mm = run.trace["insertion_mm"] + run.trace["deflection_mm"]
    drawn_mm = charts[0].axes[0].lines[0].get_xdata()
    np.testing.assert_allclose(np.maximum(drawn_mm, 0.0), travel_mm, atol=1e-5)
    panels = overlay([Curve("oblique", run.trace)], over="depth")
    assert run.summary["largest_insertion_mm"] == run.trace["insertion_mm"].max()
    assert ("inserted, largest", f"{run.trace['insertion_mm'].max():.3g} mm") in run_rows(
        run.summary
    )
    # measured: 3e-5 mm, the travel of the first tick in contact
    assert panels[0].lines[0].get_xdata().max() == pytest.approx(travel_mm.max(), abs=1e-3)


def test_needle_whose_path_is_not_along_its_axis_is_noted_and_drawn():
    """The block follows the needle that enters where the path meets the surface."""
    run = oblique_run(**{"anatomy.interval_ms": 60.0})
    assert "at 30 degrees" in run.parts.notes["axis"]
    assert "set motion.axis = [0.5, 0, 0.866]" in run.parts.notes["axis"]
    assert any("sideways" in what for _, what in run.events)
    frame, _ = organ_pictures.moment_of_press(run.parts.fields, run.trace)
    largest = np.linalg.norm(frame.points["displacement_mm"], axis=1).max()
    row = int(np.searchsorted(run.trace["time_s"], frame.time_s - 1e-9))
    assert largest == pytest.approx(run.trace["deflection_mm"][row], rel=1e-3)


def test_picture_that_fails_leaves_the_other_files(tmp_path, monkeypatch):
    def fails(run, path):
        raise ValueError("no colours")

    monkeypatch.setattr(force_depth, "draw_insertion", fails)
    changes = {"anatomy.interval_ms": 0.0, "duration_s": 0.1}
    run = simulate(load_scene("needle", changes))
    assert draw_pictures(run, tmp_path / "drawn") == [
        "insertion.png was not drawn: ValueError: no colours"
    ]
    run.save(tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["status"] == "complete", summary
    assert "insertion.png was not drawn" in summary["notes"]["pictures"]
    assert (tmp_path / "out" / "pictures" / "force_torque.png").is_file()


def test_spring_back_of_a_needle_is_part_of_the_insertion():
    depth = np.array([0.0, 1.0, 2.0, 1.5, 2.5, 4.0, 3.5, 2.5, 1.0, 1.2, 0.5, 3.0])
    inward = force_depth._inward(depth)
    np.testing.assert_array_equal(inward, [True] * 6 + [False] * 5 + [True])
