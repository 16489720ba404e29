"""The tool's distance from structures to keep clear of, held to closed forms and to plain NumPy."""

import re

import numpy as np
import pytest
import tomli_w
import trimesh

import tissue
from meshes.base.errors import InputError
from tissue.show.figures.section import draw_section, nearest_places

RADIUS_MM = 3.0
DEPTH_MM = 6.0
ASIDE_MM = 0.5
"""Of a canal along x under the block's face, and how far aside of its axis the burr goes."""
BURR_MM = 2.0
SCENE = {
    "name": "canal",
    "anatomy": {"kind": "block", "size_mm": [20.0, 12.0, 12.0]},
    "keep_clear": {"files": {"canal": "canal.stl"}},
    "voxels": {"spacing_mm": 0.4},
    "tool": {"kind": "ball-burr", "diameter_mm": 2.0 * BURR_MM, "spin_rpm": 10000.0},
    "motion": {
        "kind": "path",
        "points_mm": [[0, ASIDE_MM, 1], [0, ASIDE_MM, -4], [0, ASIDE_MM, 1]],
        "feed_mm_s": 20.0,
    },
}


def canal(scale=1.0):
    """Return the canal's surface in the frame of the site.

    It has a far piece of a hundred times its area.
    """
    made = trimesh.creation.cylinder(radius=RADIUS_MM, height=40.0, sections=256)
    made.apply_transform(trimesh.transformations.rotation_matrix(0.5 * np.pi, [0, 1, 0]))
    made.apply_translation([0.0, 0.0, -DEPTH_MM])
    far = trimesh.creation.icosphere(radius=110.0)
    far.apply_translation([0.0, 200.0, 0.0])
    made = trimesh.util.concatenate([made, far])
    made.apply_scale(scale)
    return made


def scene_in(folder, table=SCENE, overrides=None):
    folder.mkdir(exist_ok=True)
    canal().export(folder / "canal.stl")
    (folder / "scene.toml").write_text(tomli_w.dumps(table))
    return tissue.load_scene(folder / "scene.toml", overrides)


def exact_mm(run):
    """Distance of a ball from a cylinder, from where the tip was."""
    trace = run.trace
    height = trace["tool_z_mm"] + BURR_MM + DEPTH_MM
    return np.hypot(trace["tool_y_mm"], height) - RADIUS_MM - BURR_MM


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return tissue.simulate(scene_in(tmp_path_factory.mktemp("canal")))


def test_the_distance_from_a_canal_in_a_block_is_that_of_a_ball_from_a_cylinder(run):
    assert np.abs(run.trace["distance_canal_mm"] - exact_mm(run)).max() < 0.01
    found = run.summary["keep_clear"]["canal"]
    assert found["breach_depth_mm"] == pytest.approx(-exact_mm(run).min(), abs=0.01)
    assert found["breach_s"] == pytest.approx(1e-3 * (exact_mm(run) < 0.0).sum(), abs=2e-3)
    assert found["first_breach_s"] == pytest.approx(
        run.trace["time_s"][exact_mm(run) < 0.0][0], abs=2e-3
    )


def test_a_breach_is_an_event_with_its_depth(run):
    first, last = (event["what"] for event in run.summary["events"])
    assert first == "breached canal, which is to be kept clear of"
    depth = float(re.match(r"left canal: ([0-9.]+) mm deep", last)[1])
    assert 0.0 <= depth + exact_mm(run).min() < 0.01


def test_the_section_shows_where_the_tool_came_nearest(run, tmp_path):
    place = nearest_places(run)[0]
    assert place.least_mm == pytest.approx(exact_mm(run).min(), abs=0.01)
    _, y, z = place.structure_mm
    assert np.hypot(y, z + DEPTH_MM) == pytest.approx(RADIUS_MM, abs=0.01)  # on the canal
    _, y, z = place.tool_mm - [0.0, ASIDE_MM, run.trace["tool_z_mm"].min() + BURR_MM]
    assert np.linalg.norm(place.tool_mm - place.structure_mm) == pytest.approx(
        -place.least_mm, abs=0.05
    )
    assert np.hypot(y, z) == pytest.approx(BURR_MM, abs=0.05)  # on the burr
    draw_section(run, tmp_path / "section.png", axis=2, outward=1)
    assert (tmp_path / "section.png").stat().st_size > 10_000


def test_nothing_else_of_a_run_changes(run, tmp_path):
    table = {name: part for name, part in SCENE.items() if name != "keep_clear"}
    other = tissue.simulate(scene_in(tmp_path / "plain", table))
    for column in other.trace.columns:
        assert np.array_equal(other.trace[column], run.trace[column]), column
    assert "keep_clear" not in other.summary


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_a_file_is_in_the_frame_and_unit_of_the_bone(run, tmp_path, unit):
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.8]))
    turn[:3, 3] = (40.0, -30.0, 15.0)
    tmp_path.joinpath("bone").mkdir()
    folder = tmp_path / "bone"
    block = trimesh.creation.box((20.0, 12.0, 12.0))
    block.apply_translation([0.0, 0.0, -6.0])
    for name, made in (("block", block), ("canal", canal())):
        made.apply_transform(turn)
        made.apply_scale(unit)
        made.export(folder / f"{name}.stl")
    table = SCENE | {
        "anatomy": {
            "kind": "bone",
            "file": "block.stl",
            "scale_mm": 1.0 / unit,
            "centre_mm": turn[:3, 3].tolist(),
            "normal": turn[:3, 2].tolist(),
            "along": turn[:3, 0].tolist(),
        }
    }
    (folder / "scene.toml").write_text(tomli_w.dumps(table))
    other = tissue.simulate(tissue.load_scene(folder / "scene.toml"))
    assert np.abs(other.trace["distance_canal_mm"] - run.trace["distance_canal_mm"]).max() < 0.01


def test_a_hand_is_watched_too(tmp_path):
    overrides = {"device": "touch", "motion.feed_mm_s": 5.0, "duration_s": 1.2}
    held = tissue.simulate(scene_in(tmp_path, overrides=overrides))
    deep = held.trace["tool_z_mm"] < 0.5
    assert deep.any()
    assert np.abs(held.trace["distance_canal_mm"] - exact_mm(held))[deep].max() < 0.02


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (
            {"names": ["canal"]},
            "keep_clear.names must be left out for an anatomy without any, got canal",
        ),
        ({"files": {"canal": "none.stl"}}, r"keep_clear\.files\.canal must exist"),
        ({}, "keep_clear must state names or files"),
        ({"names": ["canal"], "files": {"canal": "canal.stl"}}, "got canal twice"),
        ({"files": {"Canal 1": "canal.stl"}}, "Canal 1"),
    ],
)
def test_what_cannot_be_measured_is_refused(tmp_path, change, part):
    with pytest.raises(InputError, match=part) as refused:
        tissue.simulate(scene_in(tmp_path, SCENE | {"keep_clear": change}))
    assert "\n" not in str(refused.value)


def test_a_tool_that_cuts_nothing_has_nothing_to_keep_clear_of(tmp_path):
    table = {
        "name": "wall",
        "anatomy": {"kind": "wall"},
        "tool": {"kind": "sphere-probe"},
        "motion": SCENE["motion"],
        "keep_clear": SCENE["keep_clear"],
    }
    with pytest.raises(InputError, match=r"keep_clear\.files must be left out for a wall"):
        scene_in(tmp_path, table)
