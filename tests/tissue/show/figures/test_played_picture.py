"""The picture of what a device played."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.show.figures.force_time import draw_played


@pytest.mark.parametrize(
    "changes",
    [
        {
            "device": "touch",
            "coupling.delay_ms": 2,
            "motion.points_mm": [[0, 0, 10], [0, 0, -25], [5, 0, -25]],
        },
        {"device": "six-dof", "prediction": "linear", "motion.axis": [0.3, 0, 1]},
    ],
    ids=["compressed", "torque and prediction"],
)
def test_the_picture_shows_lines_spans_and_nothing_empty(changes, tmp_path):
    run = simulate(load_scene("wall", {**changes, "duration_s": 0.9}))
    assert run.trace["device_force_z_N"].max() > 0.3
    assert run.trace["saturated"].any() == (changes["device"] == "touch")
    draw_played(run, tmp_path / "played.png")
    from matplotlib.image import imread

    picture = imread(tmp_path / "played.png")[:, :, :3]
    assert picture.shape[0] > 1000 and picture.shape[1] == 1600
    orange = np.abs(picture - np.array([0xD5, 0x5E, 0x00]) / 255.0).max(axis=2) < 0.02
    yellow = np.abs(picture - np.array([0xF6, 0xEF, 0x8E]) / 255.0).max(axis=2) < 0.08
    assert orange.sum() > 500
    assert (yellow.sum() > 5000) == bool(run.trace["saturated"].any())
