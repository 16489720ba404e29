"""Notes on a predictor of another task, on an unusual modulus and on a coarse contact area."""

import numpy as np
import pytest

from tissue import load_scene
from tissue.materials.scene_constants import Materials
from tissue.simulation.builders.organ import material_of
from tissue.simulation.builders.organ_scene import _area_note
from tissue.simulation.simulate import _training_note
from tissue.simulation.trace import TraceLayout

DEVICE = {"device": "touch", "device.prediction": "koopman"}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ""),
        ({"anatomy.interval_ms": 0.0}, ""),
        ({"device.prediction": "linear", "tool.diameter_mm": 1.0}, ""),
        ({"tool.diameter_mm": 1.0, "motion.feed_mm_s": 5.0}, "differs in tool, motion. Train"),
    ],
)
def test_predictor_that_was_trained_on_another_scene_is_noted(changes, expected):
    note = _training_note(load_scene("needle", DEVICE | changes)).get("predictor", "")
    assert expected in note and bool(expected) == bool(note)


@pytest.mark.parametrize(("modulus_kPa", "is_noted"), [(8.0, False), (100.0, False), (8e3, True)])
def test_modulus_far_outside_the_cited_range_is_noted(modulus_kPa, is_noted):
    scene = load_scene("palpation", {"organ.young_kPa": modulus_kPa})
    _, notes = material_of(scene.anatomy, scene.organ, Materials.cited)
    assert ("in kPa?" in notes["modulus"]) is is_noted


@pytest.mark.parametrize(
    ("edge_mm", "order", "wanted_mm"),
    [(2.1, 1, None), (3.0, 1, "2.1"), (6.0, 1, "2.1"), (4.2, 2, None), (6.0, 2, "4.3")],
)
def test_contact_area_of_a_coarse_mesh_is_noted(edge_mm, order, wanted_mm):
    corners = 1e-3 * edge_mm * np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]]])
    note = _area_note(corners, np.zeros((1, 3)), 8e-3, edge_m=1e-3 * edge_mm, order=order)
    assert bool(note) is (wanted_mm is not None)
    if note:
        assert f"anatomy.touch_edge_mm to {wanted_mm} or less" in note["contact area"]


def test_column_names_have_no_spaces():
    columns = TraceLayout.of(("muscle fascia",)).columns
    assert "removed_muscle_fascia_mm3" in columns and not any(" " in each for each in columns)
