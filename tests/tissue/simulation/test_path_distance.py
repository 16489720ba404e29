"""Distance of a tool in a simulated hand from the path of its scene."""

import numpy as np
import pytest

import tissue
from meshes.paths.toolpath import path_distance
from tissue.show.report.page import run_rows


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
