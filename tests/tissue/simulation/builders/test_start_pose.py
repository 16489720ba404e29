"""Recorded motion from a file of poses."""

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.progress import silent
from meshes.paths.toolpath import POSE_COLUMNS
from tissue import load_scene
from tissue.simulation.simulate import build

TILTED = Rotation.from_euler("y", 30.0, degrees=True)
MILLING = {"anatomy.size_mm": [12, 8, 5], "voxels.spacing_mm": 0.25, "motion.feed_mm_s": 20.0}


def poses(path, tip_mm):
    """A file of a tool that goes 2 mm to the side in 0.2 s, turned all the time."""
    rows = [
        (time, tip_mm[0] + 10.0 * time, *tip_mm[1:], *TILTED.as_quat())
        for time in np.linspace(0.0, 0.2, 21)
    ]
    header = ",".join(("time_s", *POSE_COLUMNS))
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    return str(path)


def replayed(file):
    scene = load_scene("milling", MILLING | {"motion": {"kind": "replay", "file": file}})
    return build(scene, compute="cpu", cores=1, report=silent)


def test_a_repeated_pose_is_noted_in_the_run(tmp_path):
    file = poses(tmp_path / "poses.csv", (-3.0, 0.0, -0.3))
    assert "motion" not in replayed(file).notes
    header, first, *rows = (tmp_path / "poses.csv").read_text().splitlines()
    (tmp_path / "poses.csv").write_text("\n".join([header, first, first, *rows]))
    assert replayed(file).notes["motion"] == "1 pose with the time of the pose before left out"
