"""Start pose of a recorded motion.

A recording whose quaternions have w first is named, and the volumes inside the bone equal the
bone's loss.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.progress import silent
from meshes.paths.toolpath import POSE_COLUMNS
from tissue import load_scene
from tissue.models.tissue_model import ToolMotion
from tissue.simulation.simulate import build

TILTED = Rotation.from_euler("y", 30.0, degrees=True)
MILLING = {"anatomy.size_mm": [12, 8, 5], "voxels.spacing_mm": 0.25, "motion.feed_mm_s": 20.0}


def poses(path, tip_mm, rotation, *, w_first=False):
    """A file of a tool that goes 2 mm to the side in 0.2 s, turned all the time."""
    x, y, z, w = rotation.as_quat()
    columns = (w, x, y, z) if w_first else (x, y, z, w)
    rows = [
        (time, tip_mm[0] + 10.0 * time, *tip_mm[1:], *columns) for time in np.linspace(0.0, 0.2, 21)
    ]
    np.savetxt(
        path,
        rows,
        delimiter=",",
        header=",".join(("time_s", *POSE_COLUMNS)),
        comments="",
        fmt="%.17g",
    )
    return str(path)


def built(changes):
    """The parts of a scene, and the volume that its bone loses where the tool is placed [mm3]."""
    scene = load_scene("milling", MILLING | changes)
    parts = build(scene, compute="cpu", cores=1, report=silent, allow_unstable=True)
    tool = ToolMotion()
    parts.motion.begin(tool)
    parts.tissue.place(tool)
    return parts, 1e9 * float(parts.tissue.removed_m3.sum())


def replayed(file):
    return built({"motion": {"kind": "replay", "file": file}})


def named(parts):
    return [
        what for time_s, what in parts.events if "read as (w, x, y, z)" in what and time_s == 0.0
    ]


def percent_in_block(cutter, tip_mm, rotation):
    """Percentage of the cutting surface below the top face of the block and between its sides."""
    shell = cutter.shell(spacing_m=cutter.profile.radius_m / 60.0)
    points_mm = tip_mm + 1e3 * rotation.apply(shell.points_m)
    length, width, height = MILLING["anatomy.size_mm"]
    low = np.array([-0.5 * length, -0.5 * width, -height])
    high = np.array([0.5 * length, 0.5 * width, 0.0])
    return 100.0 * ((points_mm > low) & (points_mm < high)).all(axis=1).mean()


def test_a_file_with_w_first_is_named_and_one_with_w_last_is_not(tmp_path):
    tip = np.array([-3.0, 0.0, -0.3])
    right, _ = replayed(poses(tmp_path / "right.csv", tip, TILTED))
    wrong, _ = replayed(poses(tmp_path / "wrong.csv", tip, TILTED, w_first=True))
    assert not named(right)
    (sentence,) = named(wrong)
    inside, by_other = (int(part.split()[-1]) for part in sentence.split("%")[:2])
    x, y, z, w = TILTED.as_quat()
    as_read = Rotation.from_quat([w, x, y, z])
    assert inside == pytest.approx(percent_in_block(wrong.cutter, tip, as_read), abs=1.0)
    assert by_other == pytest.approx(percent_in_block(wrong.cutter, tip, TILTED), abs=1.0)


def test_a_tool_that_is_deep_in_either_order_is_not_named(tmp_path):
    """A turn about its own axis leaves the tool where it is, whichever number comes first."""
    about_z = Rotation.from_euler("z", 40.0, degrees=True)
    parts, removed_mm3 = replayed(poses(tmp_path / "deep.csv", (-3.0, 0.0, -1.0), about_z))
    assert removed_mm3 > 5.0 and not named(parts)


def test_a_repeated_pose_is_noted_in_the_run(tmp_path):
    file = poses(tmp_path / "poses.csv", (-3.0, 0.0, -0.3), TILTED)
    assert "motion" not in replayed(file)[0].notes
    header, first, *rows = (tmp_path / "poses.csv").read_text().splitlines()
    (tmp_path / "poses.csv").write_text("\n".join([header, first, first, *rows]))
    parts, _ = replayed(file)
    assert parts.notes["motion"] == "1 pose left out with the same time as the pose before"
