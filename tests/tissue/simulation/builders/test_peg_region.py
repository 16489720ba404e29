"""A guide peg in the simulated region of the bone, and in a guide hole."""

import pytest

import tissue
from tissue.scene.scene import Scene
from tissue.simulation.builders.cutting import milled_voxels

PEG = {
    "name": "peg",
    "anatomy": {
        "kind": "block",
        "size_mm": [16.0, 12.0, 9.0],
        "guide_hole_diameter_mm": 3.2,
        "guide_hole_depth_mm": 5.5,
    },
    "voxels": {"spacing_mm": 0.4, "margin_mm": 0.5},
    "tool": {
        "kind": "flat-reamer",
        "diameter_mm": 8.0,
        "length_mm": 3.0,
        "spin_rpm": 500.0,
        "peg_diameter_mm": 3.0,
        "peg_length_mm": 4.0,
    },
    "motion": {"kind": "path", "points_mm": [[0, 0, 0.5], [0, 0, -1.0]], "feed_mm_s": 10.0},
}
SIDEWAYS = [[0, 0, 0.5], [0, 0, -0.5], [2.0, 0, -0.5]]
DEEP = [[0, 0, 0.5], [0, 0, -2.0]]


def scene_of(points_mm, **voxels):
    motion = PEG["motion"] | {"points_mm": points_mm}
    return Scene(**(PEG | {"motion": motion, "voxels": PEG["voxels"] | voxels}))


@pytest.mark.parametrize("points_mm", [SIDEWAYS, DEEP])
def test_a_peg_that_leaves_its_hole_is_noticed_at_any_margin(points_mm):
    runs = [tissue.simulate(scene_of(points_mm, margin_mm=margin)) for margin in (0.5, 6.0)]
    near, far = (run.summary for run in runs)
    assert [each["what"] for each in near["events"]] == [each["what"] for each in far["events"]]
    assert any("such as its peg, is pushed" in each["what"] for each in near["events"])
    removed = [sum(each["removed_mm3"].values()) for each in (near, far)]
    assert removed[0] == removed[1]


def test_only_a_peg_that_stays_in_its_hole_needs_no_bone_around_it():
    lowest = lambda scene: 1e3 * milled_voxels(scene).bounds_m[0][2]  # noqa: E731
    assert lowest(scene_of(PEG["motion"]["points_mm"])) > -4.0  # the face moves to -1 mm
    assert lowest(scene_of(SIDEWAYS)) < -4.5  # the peg moves to -4.5 mm
    by_hand = scene_of(PEG["motion"]["points_mm"]).model_copy(
        update={"device": tissue.load_scene("milling", {"device": "touch"}).device}
    )
    assert lowest(by_hand) < -5.0
