"""Sections through a run, and the depths at which the force is drawn."""

import numpy as np
import pytest
import tomli_w
import trimesh

from tissue import load_scene, simulate
from tissue.show.figures.force_depth import deepening_rows
from tissue.show.figures.nearest_points import closest
from tissue.show.figures.section import _handles, draw_section, section_of

pytest.importorskip("pyvista")

SPACING_MM = 0.4
BLOCK = {
    "name": "block",
    "anatomy": {"kind": "block", "size_mm": [8.0, 8.0, 10.0]},
    "voxels": {"spacing_mm": SPACING_MM},
    "tool": {"kind": "ball-burr", "diameter_mm": 2.0, "spin_rpm": 40000.0},
    "motion": {"kind": "path", "points_mm": [[0, 0, 1], [0, 0, -1], [0, 0, 1]], "feed_mm_s": 20.0},
    "keep_clear": {"files": {"ball": "ball.stl"}},
}


@pytest.fixture(scope="module")
def run():
    """A coarse drilling into bone of three layers."""
    changes = {"voxels.spacing_mm": SPACING_MM, "motion.feed_mm_s": 5.0, "duration_s": 0.6}
    return simulate(load_scene("glenoid", changes))


def test_section_holds_the_voxels_at_the_deepest_point(run):
    last = len(run.trace.rows) - 1
    section = section_of(run, last)
    volume = run.parts.volume
    *_, normal = section.axes.argmax(axis=1)
    np.testing.assert_array_equal(section.axes.sum(axis=0), 1.0)
    assert section.row == last
    deepest = run.trace["tool_z_mm"].argmin()
    assert section.origin_mm[normal] == run.trace[f"tool_{'xyz'[normal]}_mm"][deepest]
    index = int((section.origin_mm[normal] * 1e-3 - volume.origin_m[normal]) / volume.spacing_m)
    np.testing.assert_array_equal(section.layer, np.take(volume.layer, index, axis=normal))
    removed = np.take(volume.fraction - run.remaining, index, axis=normal) / 255
    np.testing.assert_allclose(section.start - section.left, removed, atol=1e-12)
    assert removed.sum() > 10.0
    u0, u1, v0, v1 = section.extent_mm
    assert section.start.shape == (round((u1 - u0) / SPACING_MM), round((v1 - v0) / SPACING_MM))


def test_legend_and_title_of_a_section_name_what_is_drawn(run, tmp_path):
    section = section_of(run, len(run.trace.rows) - 1)
    labels = [each.get_label() for each in _handles(run, section)]
    gone = (section.start >= 0.5) & (section.start - section.left >= 0.5)
    layers = [f"removed {run.volume.layer_names[i]}" for i in np.unique(section.layer[gone])]
    assert layers and [each for each in labels if each.startswith("removed")] == layers
    draw_section(run, tmp_path / "section.svg")
    title = (tmp_path / "section.svg").read_text()
    assert "section at" in title and "in the plane of the deepest contact so far" in title


def test_each_depth_is_drawn_once_and_up_to_the_deepest():
    down = np.linspace(1.0, -2.0, 301)
    sideways = np.full(50, -2.0)
    path = np.concatenate(
        [down, sideways, np.linspace(-2.0, 0.0, 100), np.linspace(0.0, -5.0, 101)]
    )
    rows = deepening_rows(path, path < 0.5)
    assert path[rows[0]] == pytest.approx(path[np.argmax(path < 0.5)] + 0.2, abs=0.01)
    assert (np.diff(path[rows]) < 0.0).all() and path[rows[-1]] == -5.0
    # neither the rows at rest nor those in which the tool returns to the bottom
    assert not ((rows > 300) & (path[rows] >= -2.0)).any()
    low_before = np.concatenate([[-4.0, -4.0, 1.0], down])
    assert low_before[deepening_rows(low_before, np.arange(304) > 100)][-1] == -2.0
    assert len(deepening_rows(down, np.zeros(301, dtype=bool))) == 0


def test_section_goes_through_the_tool_and_the_nearest_point_of_a_structure(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    ball.apply_translation([2.0, 2.0, -3.0])
    ball.export(tmp_path / "ball.stl")
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(BLOCK))
    run = simulate(load_scene(tmp_path / "scene.toml"))
    near = closest(run)
    least_mm = run.summary["keep_clear"]["ball"]["least_distance_mm"]
    assert run.trace["distance_ball_mm"][near.row] == pytest.approx(least_mm)
    of_tool, of_ball = near.points_mm
    assert np.linalg.norm(of_ball - of_tool) == pytest.approx(least_mm, abs=0.01)
    assert np.linalg.norm(of_ball - [2.0, 2.0, -3.0]) == pytest.approx(1.0, abs=0.01)
    section = section_of(run, near.row, of_ball)
    np.testing.assert_allclose(section.axes @ section.axes.T, np.eye(3), atol=1e-12)
    for point in (of_tool, of_ball, run.trace.vectors("tool", "mm")[near.row]):
        assert abs((point - section.origin_mm) @ section.axes[2]) < 0.05
    # the cavity holds the tool, whose tip is at the origin
    u0, _, v0, _ = section.extent_mm
    at = tuple(int((place - low) / SPACING_MM) for place, low in ((0.0, u0), (0.5, v0)))
    assert section.start[at] == 1.0 and section.left[at] == 0.0
    draw_section(run, tmp_path / "section.svg")
    assert "surface of ball" in (tmp_path / "section.svg").read_text()
    assert "the tool&apos;s axis and the nearest point of ball" in (
        tmp_path / "section.svg"
    ).read_text().replace("'", "&apos;")


def test_section_shows_the_depth_of_a_breach_and_other_distances_at_this_time(tmp_path):
    for name, centre in (("ball", [0.3, 0.0, 2.2]), ("far", [0.0, 3.5, -3.0])):
        ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
        ball.apply_translation(centre)
        ball.export(tmp_path / f"{name}.stl")
    files = {"files": {"ball": "ball.stl", "far": "far.stl"}}
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(BLOCK | {"keep_clear": files}))
    with pytest.warns(UserWarning, match=r"the tool starts 1\.6\d mm inside ball\. Check the path"):
        run = simulate(load_scene(tmp_path / "scene.toml"))
    near = closest(run)
    depth_mm = run.summary["keep_clear"]["ball"]["breach_depth_mm"]
    assert near.row == 0 and depth_mm == pytest.approx(2.0 - np.hypot(0.3, 0.2), abs=0.02)
    of_tool, of_ball = near.points_mm
    assert np.linalg.norm(of_ball - of_tool) == pytest.approx(depth_mm, abs=0.02)
    assert np.linalg.norm(of_ball - [0.3, 0.0, 2.2]) == pytest.approx(1.0, abs=0.01)
    assert np.linalg.norm(of_tool - [0.0, 0.0, 2.0]) == pytest.approx(1.0, abs=0.01)
    draw_section(run, tmp_path / "section.svg")
    drawn = (tmp_path / "section.svg").read_text()
    assert f"{depth_mm:.3f} mm inside ball" in drawn and "path of its tip" not in drawn
    far_mm = run.trace["distance_far_mm"]
    assert far_mm.min() < far_mm[0] - 1.0
    assert f"{far_mm[0]:.3f} mm away from the tool" in drawn
