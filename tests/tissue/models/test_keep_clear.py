"""The tool's distance from structures to keep clear of, held to closed forms and to plain NumPy."""

import re

import numpy as np
import pytest
import tomli_w
import trimesh

import tissue
from meshes.base.errors import InputError
from tissue.scene.load import parse_overrides
from tissue.show.report.page import run_rows
from tissue.simulation.builders import cutting, force_scale

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


def test_the_result_table_begins_with_the_breach_and_has_the_simulated_volume(run):
    rows = dict(run_rows(run.summary))
    found = run.summary["keep_clear"]["canal"]
    depth, first_s = found["breach_depth_mm"], found["first_breach_s"]
    row = int(run.trace["distance_canal_mm"].argmin())
    tip_mm = run.trace.vectors("tool", "mm")[row]
    time_s = run.trace["time_s"][row]
    assert found["least_distance_at_s"] == pytest.approx(time_s)
    assert found["least_distance_tip_mm"] == pytest.approx(tip_mm.tolist())
    x, y, z = (f"{round(each, 3) + 0.0:g}" for each in tip_mm)
    text = (
        f"breached, {depth:.2g} mm deep, first at {first_s:.3f} s, deepest at {time_s:.3f} s, "
        f"tip at ({x}, {y}, {z}) mm"
    )
    assert next(iter(rows.items())) == ("smallest distance to canal", text)
    (layer,) = run.summary["start_mm3"]
    removed = run.summary["removed_mm3"][layer]
    start = run.summary["start_mm3"][layer]
    assert rows[f"removed {layer}"] == f"{removed:.3g} of the simulated {start:.4g} mm³"
    summary = run.summary | {"start_mm3": {layer: 0.0}}
    assert f"removed {layer}" not in dict(run_rows(summary))
    law = {"solve_ms": {"median": 282.44, "p99": 920.4}}
    name = "solve of the law, median / 99 %"
    assert dict(run_rows(run.summary | {"law": law}))[name] == "282 / 920 ms" and name not in rows


def test_a_breach_is_an_event_with_its_depth(run):
    first, last = (event["what"] for event in run.summary["events"])
    assert first == "breached canal, which is to be kept clear of"
    depth = float(re.match(r"left canal: ([0-9.]+) mm deep", last)[1])
    assert 0.0 <= depth + exact_mm(run).min() < 0.01


def test_an_event_and_a_row_state_the_first_time_within_the_margin(tmp_path, run):
    closer = tissue.simulate(scene_in(tmp_path, overrides={"keep_clear.margin_mm": 0.5}))
    np.testing.assert_array_equal(closer.trace.rows, run.trace.rows)
    first, *others = closer.summary["events"]
    time_s = run.trace["time_s"][np.argmax(run.trace["distance_canal_mm"] < 0.5)]
    assert first == {"time_s": time_s, "what": "came closer than 0.5 mm to canal"}
    assert others == run.summary["events"]
    found = closer.summary["keep_clear"]["canal"]
    assert (found["margin_mm"], found["first_below_margin_s"]) == (0.5, pytest.approx(time_s))
    row = dict(run_rows(closer.summary))["smallest distance to canal"]
    assert row == dict(run_rows(run.summary))["smallest distance to canal"]
    is_closer = run.trace["distance_canal_mm"] < 0.5
    assert found["below_margin_s"] == pytest.approx(1e-3 * is_closer.sum(), abs=1e-9)
    unbroken = found | {"first_breach_s": None, "least_distance_mm": 0.2}
    unbroken |= {"least_distance_at_s": 1.2346, "least_distance_tip_mm": [-1e-6, 0.25, -3.0]}
    rows = dict(run_rows(closer.summary | {"keep_clear": {"canal": unbroken}}))
    end = f", closer than the margin of 0.5 mm from {time_s:.3f} s"
    where = " at 1.235 s, tip at (0, 0.25, -3) mm"
    assert rows["smallest distance to canal"] == f"0.200 mm{where}{end}"
    # runs of earlier versions
    del unbroken["least_distance_at_s"], unbroken["least_distance_tip_mm"]
    rows = dict(run_rows(closer.summary | {"keep_clear": {"canal": unbroken}}))
    assert rows["smallest distance to canal"] == f"0.200 mm{end}"
    assert "margin_mm" not in run.summary["keep_clear"]["canal"]


def test_a_tool_that_stays_away_keeps_the_margin(tmp_path):
    changes = {"keep_clear.margin_mm": 0.5, "motion.points_mm": [[0, 0, 1], [0, 0, -1]]}
    summary = tissue.simulate(scene_in(tmp_path, overrides=changes)).summary
    assert summary["events"] == []
    assert summary["keep_clear"]["canal"]["first_below_margin_s"] is None
    assert summary["keep_clear"]["canal"]["below_margin_s"] == 0.0
    row = dict(run_rows(summary))["smallest distance to canal"]
    assert row.endswith(" mm, margin of 0.5 mm kept")


@pytest.mark.parametrize("text", ["[Pulp]", "Pulp", '["Pulp"]', "pulp,canal"])
@pytest.mark.parametrize("device", ["none", "touch"])
def test_a_name_that_the_anatomy_does_not_have_is_refused_before_voxels(monkeypatch, text, device):
    for module in (cutting, force_scale):
        monkeypatch.setattr(module, "volume_of", pytest.fail)
    texts = ["stress=none", f"device={device}", f"keep_clear.names={text}"]
    scene = tissue.load_scene("molar", parse_overrides(texts))
    words = r"keep_clear.names must be structures of the anatomy \(pulp\), got .*\. Use pulp, or"
    with pytest.raises(InputError, match=words):
        tissue.simulate(scene)


def test_one_structure_needs_no_list():
    (entry,) = parse_overrides(["keep_clear.names=pulp"]).items()
    assert tissue.load_scene("molar", dict([entry])).keep_clear.names == ("pulp",)
    with pytest.raises(InputError, match=r"must be a list of names, got 3\."):
        tissue.load_scene("molar", {"keep_clear.names": 3})
