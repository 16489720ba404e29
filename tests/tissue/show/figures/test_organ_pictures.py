"""Pictures of a soft organ at different instants, and runs of which a picture fails."""

import json

import pytest

from tissue import load_scene, simulate
from tissue.show.figures import draw_pictures, force_depth, organ_pictures

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
