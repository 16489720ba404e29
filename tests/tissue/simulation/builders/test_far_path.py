"""Note on a path that leads far away from the bone, for example because of a wrong unit."""

from tissue import load_scene, simulate


def test_a_path_that_leads_far_from_the_bone_is_noted():
    coarse = {"voxels.spacing_mm": 0.5, "voxels.margin_mm": 1.0, "duration_s": 0.01}
    notes = {}
    for height_mm in (90.0, -1600.0):
        points = [[0.0, 0.0, 0.5], [0.0, 0.0, -1.0], [0.0, 0.0, height_mm]]
        scene = load_scene("milling", coarse | {"motion.points_mm": points})
        notes[height_mm] = simulate(scene).parts.notes.get("far path")
    # A robot may approach from 90 mm above the bone.
    assert notes[90.0] is None
    assert notes[-1600.0].startswith("motion.points_mm leads to (0, 0, -1600) mm")
    assert "mm away from the simulated tissue" in notes[-1600.0]
    assert notes[-1600.0].endswith("are in mm")
