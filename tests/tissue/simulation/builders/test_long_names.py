"""A file's name that the system cannot take is a file that is not there."""

import pytest

import tissue
from meshes.base.errors import InputError

LONG = "a" * 300
BURR = {"kind": "ball-burr", "diameter_mm": 2.0, "spin_rpm": 1e4}
PATH = {"kind": "path", "points_mm": [[0, 0, 0.3], [0, 0, -0.7]], "feed_mm_s": 30.0}
BLOCK = {"kind": "block"}


@pytest.mark.parametrize(
    "change",
    [
        {"anatomy": {"kind": "molar", "file": LONG}},
        {"anatomy": {"kind": "bone", "file": f"{LONG}.stl", "centre_mm": [0.0, 0.0, 0.0]}},
        {"anatomy": {"kind": "block", "file": LONG, "threshold": 1.0}},
        {"motion": {"kind": "replay", "file": f"{LONG}.csv"}},
        {"keep_clear": {"files": {"canal": f"{LONG}.stl"}}},
    ],
)
def test_it_is_refused_in_one_sentence(change):
    scene = tissue.Scene.model_validate(
        {"name": "x", "anatomy": BLOCK, "tool": BURR, "motion": PATH} | change
    )
    with pytest.raises(InputError, match="exist") as refused:
        tissue.simulate(scene)
    assert "\n" not in str(refused.value)
