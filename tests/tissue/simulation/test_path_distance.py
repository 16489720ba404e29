"""Distance of a tool in a simulated hand from the path of its scene."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tissue
from meshes.paths.toolpath import path_distance
from tissue.show.report.page import run_rows
from tissue.simulation import findings
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.findings import path_note


def test_the_summary_has_the_largest_distance_from_the_path():
    run = tissue.simulate(tissue.load_scene("wall", {"duration_s": 0.4}))
    path_mm = np.array(run.scene.motion.points_mm)
    exact_mm = path_distance(run.trace.vectors("tool", "mm"), path_mm)
    touching = run.trace["contact_mm2"] > 0.0
    found = run.summary["path_distance_mm"]
    assert found["largest"] == pytest.approx(exact_mm.max())
    assert found["largest_in_contact"] == pytest.approx(exact_mm[touching].max(initial=0.0))
    row = dict(run_rows(run.summary))[
        "largest distance from the path, in contact / in the whole run"
    ]
    assert row == f"{found['largest_in_contact']:.3g} / {found['largest']:.3g} mm"


def test_a_scripted_tool_has_no_distance_from_its_path():
    scene = tissue.load_scene("milling", {"duration_s": 0.02, "voxels.spacing_mm": 0.5})
    assert "path_distance_mm" not in tissue.simulate(scene).summary


def test_a_hand_far_from_its_path_gets_a_note_with_a_smaller_force_scale():
    scene = tissue.load_scene("molar", {"device": "touch", "coupling.force_scale": 0.99})
    parts = SimpleNamespace(cutter=cutter_of(scene.tool), keep_clear=None)
    near_mm = {"largest_in_contact": 0.9, "largest": 5.0}  # the bur has a diameter of 1 mm
    assert path_note(scene, parts, near_mm) == {}
    (note,) = path_note(scene, parts, {"largest_in_contact": 6.95, "largest": 23.4}).values()
    # 0.99 x 0.5 mm / 23.4 mm = 0.0212
    assert "left the path by 23.4 mm" in note
    assert "Set coupling.force_scale = 0.02 instead of 0.99. The largest force at the dev" in note
    assert "then 0.022 N. The friction of touch, 0.26 N, hides this force: use another dev" in note
    quiet = tissue.load_scene("molar", {"device": "six-dof", "coupling.force_scale": 0.99})
    far_mm = {"largest_in_contact": 1.2, "largest": 1.3}
    (note,) = path_note(quiet, parts, far_mm).values()
    assert "hides" not in note
    assert "smaller coupling.motion_scale, such as 0.2 instead of 1, the tool moves less" in note
    still = SimpleNamespace(cutter=replace(parts.cutter, spin_rad_s=0.0))
    assert path_note(scene, still, {"largest_in_contact": 6.95, "largest": 23.4}) == {}
    assert path_note(scene, parts, None) == {}


def test_a_hand_too_close_to_a_structure_gets_a_note_with_a_smaller_motion_scale():
    scene = tissue.load_scene("molar", {"device": "touch", "coupling.motion_scale": 0.5})
    kept = {"pulp": {"least_distance_mm": 0.74, "margin_mm": 1.0}}
    parts = SimpleNamespace(
        cutter=cutter_of(scene.tool), keep_clear=SimpleNamespace(summary=lambda: kept)
    )
    (note,) = path_note(scene, parts, {"largest_in_contact": 0.64, "largest": 0.64}).values()
    assert "left the path by 0.64 mm. The smallest distance to pulp was 0.740 mm. With a" in note
    assert "coupling.motion_scale, such as 0.1 instead of 0.5" in note
    assert "force_scale" not in note
    for stated, suggested in ((0.02, "such as 0.01 instead of 0.02"), (0.01, None)):
        slow = tissue.load_scene("molar", {"device": "touch", "coupling.motion_scale": stated})
        (note,) = path_note(slow, parts, {"largest_in_contact": 0.64, "largest": 0.64}).values()
        assert suggested in note if suggested else "motion_scale" not in note
    # the path itself must be closer than 1 mm if the hand was only 0.2 mm away from it
    assert path_note(scene, parts, {"largest_in_contact": 0.2, "largest": 0.2}) == {}
    kept["pulp"] = {"least_distance_mm": 0.01}
    assert path_note(scene, parts, {"largest_in_contact": 0.64, "largest": 0.64}) == {}
    kept["pulp"] = {"least_distance_mm": -0.01}
    assert path_note(scene, parts, {"largest_in_contact": 0.64, "largest": 0.64}) != {}


def test_the_notes_of_a_run_contain_the_note_on_its_path(monkeypatch):
    monkeypatch.setattr(findings, "FAR_RADII", -1.0)
    changes = {"device": "touch", "duration_s": 0.02, "voxels.spacing_mm": 0.5}
    notes = tissue.simulate(tissue.load_scene("milling", changes)).summary["notes"]
    assert "coupling.force_scale = " in notes["distance from the path"]


def test_a_replay_of_a_file_in_metres_gets_a_note(tmp_path):
    header = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    rows = "0,0,0,0.002,0,0,0,1\n0.02,0,0,-0.001,0,0,0,1\n"
    (tmp_path / "poses.csv").write_text(f"{header}\n{rows}")
    motion = {"motion.kind": "replay", "motion.file": str(tmp_path / "poses.csv")}
    run = tissue.simulate(tissue.load_scene("milling", motion | {"voxels.spacing_mm": 0.5}))
    note = run.summary["notes"]["length of the path"]
    assert note.startswith("only 0.003 mm") and "columns of motion.file" in note


def test_a_needle_that_replays_a_file_in_metres_gets_a_note(tmp_path):
    header = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    rows = "0,0,0,0.005,0,0,0,1\n0.02,0,0,-0.035,0,0,0,1\n"
    (tmp_path / "poses.csv").write_text(f"{header}\n{rows}")
    motion = {"motion.kind": "replay", "motion.file": str(tmp_path / "poses.csv")}
    changes = motion | {"anatomy.interval_ms": 0.0}
    notes = tissue.simulate(tissue.load_scene("needle", changes)).summary["notes"]
    assert "positions span only 0.04 mm" in notes["length of the path"]
    deep = rows.replace("0.035", "1")
    (tmp_path / "poses.csv").write_text(f"{header}\n{deep}")
    notes = tissue.simulate(tissue.load_scene("needle", changes)).summary["notes"]
    assert "length of the path" not in notes
