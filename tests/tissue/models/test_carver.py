"""Carving of a moving tool.

The tests cover volumes that a ball sweeps in closed form, and the lag of the carving behind the
tool.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kernels.carving import PHASES
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SPACING_M = 1e-4
LAG_M = 2e-5
"""Longest travel of the tool between two visits of a brick."""


def solid_bone(radius_m, half_m):
    """A ball burr and a solid cube of bone around the origin."""
    count = 2 * round(half_m / SPACING_M)
    shape = (count,) * 3
    volume = VoxelVolume(
        np.full(3, -0.5 * count * SPACING_M),
        SPACING_M,
        np.full(shape, 255, np.uint8),
        np.zeros(shape, np.uint8),
        np.full(shape, 1800, np.uint16),
        ("bone",),
    )
    cutter = Cutter(ball_burr(diameter_m=2.0 * radius_m), 4, 500.0)
    return BoneModel(volume, cutter, (cutting_coefficients("bone"),))


def removed_m3(bone):
    return float(bone.carver.removed_steps.sum()) / 65535.0 * SPACING_M**3


def turn_about_tip(bone, tip_m, angles_rad):
    """Turn the tool about the x axis through its tip.

    Returns the volume removed at every angle after the first.
    """
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:] = tip_m
    motion.heading[1] = (1.0, 0.0, 0.0)
    removed = []
    for tick, angle in enumerate(angles_rad):
        motion.rotation[:] = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
        if tick == 0:
            bone.place(motion)
        else:
            bone.advance(motion)
        removed.append(removed_m3(bone))
    return np.array(removed[1:]) - removed[0]


def slide(bone, start_m, along, travels_m):
    """Move the tool along a line; return the volume removed at every travel."""
    motion = ToolMotion(speed_m_s=1e-3)
    motion.heading[0] = along
    motion.tip_m[:] = start_m
    bone.place(motion)
    before = removed_m3(bone)
    removed = []
    for travel in travels_m:
        motion.tip_m[:] = start_m + travel * along
        bone.advance(motion)
        removed.append(removed_m3(bone) - before)
    return np.array(removed)


def test_a_slow_tool_is_carved_a_tenth_of_a_voxel_late_on_average():
    """A slow tool is carved a tenth of a voxel late on average.

    A brick waits for 0 to 20 um of travel, so a ball's front lags by half of that: pi R^2 times 10
    um are missing.
    """
    radius = 1e-3
    along = np.array([0.8, 0.0, -0.6])
    travels = np.arange(1, 601) * 5e-7
    bone = solid_bone(radius, 2.4e-3)
    removed = slide(bone, np.array([-1e-4, 1e-5, -1e-3]), along, travels)
    swept = np.pi * radius**2 * travels
    lag = (swept - removed)[100:] / (np.pi * radius**2)
    # the groups' turns are 1.25 um apart
    assert lag.mean() == pytest.approx(0.5 * LAG_M, abs=0.03 * LAG_M)
    bone.finish()
    everything = np.pi * radius**2 * (travels[-1] + 4.0 / 3.0 * radius)
    assert removed_m3(bone) == pytest.approx(everything, rel=1e-3)


def test_a_tool_that_only_turns_is_carved_as_far_as_its_far_end_moves():
    """A tool that only turns is carved as far as its far end moves.

    By Pappus, a ball turned about its tip by a sweeps pi R^2 times R a; its far end, 2 R away, sets
    the lag.
    """
    radius = 1e-3
    step = 2.5e-4
    angles = np.arange(401) * step
    bone = solid_bone(radius, 2.4e-3)
    removed = turn_about_tip(bone, [1e-5, 2e-5, -1e-3], angles)
    swept = np.pi * radius**3 * angles[1:]
    late_rad = (swept - removed)[100:] / (np.pi * radius**3)
    assert late_rad.mean() == pytest.approx(0.5 * LAG_M / (2.0 * radius), rel=0.08)
    bone.finish()
    assert removed_m3(bone) - 4.0 / 3.0 * np.pi * radius**3 == pytest.approx(swept[-1], rel=5e-3)


def test_a_tool_that_turns_far_in_one_tick_leaves_no_gap():
    """A tool that turns far in one tick leaves no gap.

    0.5 rad moves the far end by 10 voxels; steps of half a voxel leave scallops of 0.1 % at most.
    """
    radius = 1e-3
    bone = solid_bone(radius, 2.4e-3)
    removed = turn_about_tip(bone, [1e-5, 2e-5, -1e-3], [0.0, 0.5])
    assert removed[-1] == pytest.approx(np.pi * radius**3 * 0.5, rel=5e-3)


def test_a_tool_that_moves_far_in_one_tick_leaves_no_gap():
    radius = 1e-3
    along = np.array([0.48, 0.6, 0.64])
    bone = solid_bone(radius, 2.4e-3)
    removed = slide(bone, np.array([-3e-4, -4e-4, -1.3e-3]), along, [1e-3])
    assert removed[-1] == pytest.approx(np.pi * radius**2 * 1e-3, rel=3e-3)


def test_the_groove_of_a_small_ball_is_straight_along_its_path():
    """A capsule's volume, within 0.005 of a voxel over its surface.

    A ball of 3 voxels curves away from its tangent plane by 1/12 of a voxel over R on average, the
    groove that it leaves by half of that: taking the ball's curvature for the groove's is wrong by
    0.014 of a voxel.
    """
    radius = 3e-4
    along = np.array([0.6, 0.64, 0.48])
    length = 3e-3
    bone = solid_bone(radius, 2.4e-3)
    start = -0.5 * length * along + np.array([1.3e-5, 2.1e-5, 0.7e-5 - radius])
    slide(bone, start, along, np.arange(1, 301) * 1e-5)
    bone.finish()
    capsule = np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    surface = 2.0 * np.pi * radius * (length + 2.0 * radius)
    assert (removed_m3(bone) - capsule) / surface == pytest.approx(0.0, abs=0.005 * SPACING_M)


def test_a_tool_at_rest_is_brought_up_to_date_by_and_by():
    """All that it owes after a short move is carved while it rests, without `finish`."""
    radius = 1e-3
    along = np.array([0.6, 0.0, -0.8])
    bone = solid_bone(radius, 2.4e-3)
    travels = np.concatenate([np.arange(1, 11) * 1e-6, np.full(PHASES, 1e-5)])
    removed = slide(bone, np.array([0.0, 0.0, -1e-3]), along, travels)
    before = bone.carver.changes
    bone.finish()
    assert bone.carver.changes == before
    assert removed[9] < 0.8 * removed[-1]
    assert removed[-1] == pytest.approx(np.pi * radius**2 * 1e-5, rel=0.02)


def test_a_long_step_is_carved_in_parts_of_half_a_voxel_at_most():
    """A long step is carved in parts of half a voxel at most.

    The move of a tick, 0.3 to 10 voxels, is carved once for every half voxel that it begins. A
    short move is carved by its debt.
    """
    for travel, parts in ((0.55, 2), (1.2, 3), (9.9, 20)):
        bone = solid_bone(3e-4, 1.6e-3)
        motion = ToolMotion(speed_m_s=1e-3)
        motion.heading[0] = (0.0, 0.0, -1.0)
        bone.place(motion)
        before = bone.carver.changes
        motion.tip_m[2] = -travel * SPACING_M
        bone.advance(motion)
        assert bone.carver.changes - before == parts


OLDER_LAG_M = 2.5e-4
"""Travel of the tool after which its cuts may become older cuts."""
REACH = 0.85
"""Smallest distance of a voxel's centre to a tool that comes within reach of its block [voxel].

It is half the diagonal of a block less half that of a voxel, and rounding.
"""


def kept_distances(bone):
    """Return distances to the swept solid and to older cuts [voxel], each of shape (bricks, 512)."""
    count = len(bone.store.places)
    arrays = bone.store.swept, bone.store.older
    return [(array.numpy()[:count].astype(int) - 32768) / 4096.0 for array in arrays]


def offsets_m(bone, centre_m):
    """Return vectors from a point to all stored voxels [m], shape (bricks, 512, 3)."""
    inner = np.array(list(np.ndindex(4, 4, 4, 2, 2, 2)))
    voxel = 8 * bone.store.places[:, None] + 2 * inner[:, :3] + inner[:, 3:]
    return bone.store.grid.origin_m + (voxel + 0.5) * SPACING_M - centre_m


def test_a_tool_that_rests_or_dithers_keeps_no_older_cuts():
    """A tool whose path is shorter than the lag keeps no older cuts where bone counts."""
    bone = solid_bone(1e-3, 2.4e-3)
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:] = (0.0, 0.0, -1e-3)
    bone.place(motion)
    placed, _ = kept_distances(bone)
    for tick in range(100):
        motion.tip_m[0] = 0.2 * LAG_M * np.sin(0.7 * tick)
        bone.advance(motion)
    bone.finish()
    swept, older = kept_distances(bone)
    outside = swept > swept.min()  # not in a block that lies inside the tool as a whole
    assert (older[outside] > REACH).all() and (swept[outside] < placed[outside]).any()


def test_bone_behind_a_moving_tool_is_an_older_cut_and_bone_in_front_is_not():
    """Bone behind a moving tool is an older cut, and bone in front of it is not.

    The cuts in a block that faces backward by 0.2 become older cuts once in every 0.25 mm, after
    another 0.25 mm. Over these, the direction to a voxel turns by up to 0.17. The ball of 30 voxels skips bricks and
    blocks behind it.
    """
    radius = 3e-3
    along = np.array([0.48, 0.6, 0.64])
    bone = solid_bone(radius, 5e-3)
    start = np.array([-6e-4, -7e-4, -3.8e-3])
    slide(bone, start, along, np.arange(1, 601) * 2e-6)
    swept, older = kept_distances(bone)
    assert (older >= swept).all()
    offset = offsets_m(bone, start + 1.2e-3 * along + [0.0, 0.0, radius])
    distance = np.linalg.norm(offset, axis=2)
    cut = (np.abs(distance - radius) < 0.5 * SPACING_M) & (swept > swept.min())
    facing = (offset @ along) / distance
    behind, front = cut & (facing < -0.3), cut & (facing > 0.0)
    assert behind.sum() > 100 and front.sum() > 1000
    assert (older[behind] == swept[behind]).all() and (older[front] > REACH).all()


@pytest.mark.parametrize("degrees", [40.0, 180.0])
def test_all_cuts_become_older_cuts_soon_after_a_change_of_direction(degrees):
    """Older cuts hold all that was cut before a turn, once the tool has moved by twice the lag."""
    radius = 1e-3
    bone = solid_bone(radius, 2.4e-3)
    start = np.array([-3e-4, -2e-4, -1e-3])
    along = np.array([1.0, 0.0, 0.0])
    slide(bone, start, along, np.arange(1, 301) * 2e-6)
    motion = ToolMotion(speed_m_s=1e-3)
    corner = start + 6e-4 * along
    turned = Rotation.from_euler("y", degrees, degrees=True).apply(along)
    before, _ = kept_distances(bone)
    for travel in np.arange(0.0, 2.0 * (OLDER_LAG_M + LAG_M), 2e-6):
        motion.tip_m[:] = corner + travel * turned
        bone.advance(motion)
    swept, older = kept_distances(bone)
    offset = offsets_m(bone, motion.tip_m + np.array([0.0, 0.0, radius]))
    near = np.abs(np.linalg.norm(offset, axis=2) - radius) < 0.5 * SPACING_M
    was_cut = near & (before < 0.5) & (swept > swept.min())
    assert was_cut.sum() > 200 and (older[was_cut] <= before[was_cut]).all()
