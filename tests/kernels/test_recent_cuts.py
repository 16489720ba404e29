"""Cuts at a tool's last poses against closed forms, and the poses that are kept."""

import numpy as np
import pytest
from bone_blocks import SOFT, solid, tilted_motion
from cutting_in_numpy import cut_at
from scipy.spatial.transform import Rotation

from kernels.engagement import DISTANCE, WIDTH
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.models.bone.model import BoneModel
from tissue.models.bone.recent_poses import RecentPoses
from tissue.models.tissue_model import ToolMotion

TURNS = {
    "moved": Rotation.identity(),
    "tilted": Rotation.from_rotvec([0.06, -0.05, 0.0]),
    "tilted and rolled": Rotation.from_rotvec([0.06, -0.05, 0.0]) * Rotation.from_euler("z", 1.2),
}


@pytest.mark.parametrize("name", TURNS)
def test_cut_of_a_ball_at_its_last_pose_is_known_within_half_a_micrometre(name):
    """In front of an element, the cut of a ball ends where a ray meets its sphere.

    The ball is tilted by 0.08 rad, its centre moves by 40 um, and it returns.
    """
    radius = 1.5e-3
    model = BoneModel(solid(48), Cutter(ball_burr(diameter_m=2.0 * radius), 5, 700.0), (SOFT,))
    motion = tilted_motion()
    model._recent.place(motion)
    other = ToolMotion(speed_m_s=1e-3)
    other.rotation[:] = motion.rotation @ TURNS[name].as_matrix()
    # The centre of the ball is displaced by 40 um.
    centre = motion.tip_m + radius * motion.rotation[:, 2] + [3e-5, 2e-5, -1.7e-5]
    other.tip_m[:] = centre - radius * other.rotation[:, 2]
    model._recent.add(other)
    model._recent.add(motion)
    model.find_bone(motion.tip_m, motion.rotation, np.zeros(6), 1e-3)
    found = model._forces.found.numpy().transpose(1, 0, 2)
    found = found.reshape(len(found), -1)[:, : len(model.shell.areas_m2)]
    points = motion.tip_m + model.shell.points_m @ motion.rotation.T
    normals = model.shell.normals @ motion.rotation.T
    along = ((centre - points) * normals).sum(axis=1)
    inside = radius**2 - ((centre - points) ** 2).sum(axis=1) + along**2
    gap = along + np.sqrt(np.maximum(inside, 0.0))
    seen = (found[WIDTH] > 0.0) & (gap > 1e-6) & (gap < 1.8e-5)
    assert seen.sum() > 100
    assert found[DISTANCE][seen] == pytest.approx(gap[seen], abs=4e-7)
    # Bone that is farther away than the search reaches is not found.
    assert not found[WIDTH][(gap > 2.2e-5) & (points[:, 2] < 2e-3)].any()


def test_cuts_of_numpy_at_other_poses_are_those_of_a_ball():
    """The formula of the kernel is exact to second order: 5 nm for a tilt of 10 mrad."""
    radius = 1.5e-3
    cutter = Cutter(ball_burr(diameter_m=2.0 * radius), 5, 700.0)
    shell = cutter.shell(spacing_m=1e-4)
    rotation = Rotation.from_rotvec([0.008, -0.006, 0.0]).as_matrix()
    centre = np.array([1e-5, -5e-6, radius + 8e-6])
    tip = centre - radius * rotation[:, 2]
    found = cut_at(shell, 1.0 / radius, [tip], [rotation], np.zeros(3), np.eye(3))[0]
    along = ((centre - shell.points_m) * shell.normals).sum(axis=1)
    inside = radius**2 - ((centre - shell.points_m) ** 2).sum(axis=1) + along**2
    assert found == pytest.approx(along + np.sqrt(inside), abs=5e-9)


def test_last_poses_reach_back_further_than_older_cuts_lag_behind():
    """The kept poses reach back by twice the lag of older cuts, in steps of their spacing."""
    recent = RecentPoses(3e-3, device="cpu")
    for tick_m in (1e-6, 3e-6, 1.1e-5, 4e-5):
        motion = ToolMotion(speed_m_s=1.0)
        recent.place(motion)
        for _ in range(round(2e-3 / tick_m)):
            motion.tip_m[0] += tick_m
            recent.add(motion)
        recent.seen_from(motion.tip_m, motion.rotation)
        back = -np.unique(recent.mirror.host[:, 0, 0].round(9))[::-1]
        assert back[0] == 0.0 and back[-1] > 5e-4
        apart = np.diff(back)
        assert apart[back[:-1] < 3e-5].max() < 4e-6 + tick_m + 1e-9
        assert apart.max() < 2.4e-5 + tick_m + 1e-9


def test_a_tool_that_rolls_about_its_axis_keeps_its_last_poses():
    """A roll moves the tool's surface into itself, so no place is used for it."""
    recent = RecentPoses(3e-3, device="cpu")
    motion = ToolMotion(speed_m_s=1.0)
    recent.place(motion)
    for tick in range(200):
        motion.tip_m[0] += 2e-6 * (tick < 100)
        motion.rotation[:] = Rotation.from_euler("z", 0.02 * tick).as_matrix()
        recent.add(motion)
    recent.seen_from(motion.tip_m, motion.rotation)
    assert not recent.turns and not recent.mirror.host[:, 1].any()
    assert np.linalg.norm(recent.mirror.host[:, 0], axis=1).max() == pytest.approx(2e-4, abs=1e-6)
