"""Tool on a rotational spring, and one that feels rigid bone with its surface."""

from math import inf

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.haptics.proxy.held_tool import FURTHEST_RAD, HeldTurn
from tissue.haptics.proxy.probing_tool import ProbedBone, ProbingTool
from tissue.haptics.proxy.proxy import ToolShell
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.motion import frame_along
from tissue.motion.quaternion import conjugate, exponential, logarithm, product

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
SPACING = 1e-4
STEP_S = 1e-3
DOWN = np.array([0.0, 0.0, -1.0])


def apart(tool, device):
    """Rotation vector from device to tool [rad]."""
    return np.array(logarithm(product(tool, conjugate(device))))


@pytest.mark.parametrize("tissue_Nm_rad", [0.0, 0.02, 0.3, 3.0, 30.0])
def test_spring_and_tissue_balance_also_a_hundred_times_stiffer(tissue_Nm_rad):
    """Spring and tissue balance, also for a hundred times stiffer tissue.

    For tissue T = T0 - k_t phi on the tool turned by phi in the world, theta = (T0 - k_t phi_d) /
    (k + k_t).
    """
    spring, device = 0.3, exponential((0.2, -0.1, 0.05))
    steady, turn = np.array([0.01, 0.02, -0.03]), HeldTurn(spring)
    torque = steady
    for _ in range(300):
        tool = turn.follow(device, torque)
        torque = steady - tissue_Nm_rad * apart(tool, device)
    np.testing.assert_allclose(apart(tool, device), steady / (spring + tissue_Nm_rad), rtol=1e-2)
    np.testing.assert_allclose(
        spring * apart(tool, device), torque, atol=1e-2 * np.linalg.norm(steady)
    )


def test_without_torque_or_with_a_rigid_spring_the_tool_is_as_the_device():
    device = exponential((0.4, 0.3, -1.0))
    assert HeldTurn(0.3).follow(device, np.zeros(3)) == device
    assert HeldTurn(inf).follow(device, np.array([1.0, 0.0, 0.0])) == device
    turn = HeldTurn(0.3)
    turn.follow(device, np.array([0.0, 0.0, 0.05]))
    assert turn.follow(device, np.zeros(3)) == device


def test_the_tool_goes_with_a_device_that_turns():
    """A torque that stays is answered by the same turn of the spring wherever the device is."""
    turn, torque = HeldTurn(0.5), np.array([0.0, 0.0, 0.1])
    for angle in np.linspace(0.0, 3.0, 400):
        device = exponential((angle, 0.0, 0.0))
        tool = turn.follow(device, torque)
        np.testing.assert_allclose(apart(tool, device), torque / 0.5, atol=1e-12)


def test_no_torque_turns_the_spring_past_its_bound():
    turn = HeldTurn(0.1)
    for size in (0.3, 3.0, 1e9):
        theta = apart(turn.follow(UPRIGHT, np.array([0.0, size, 0.0])), UPRIGHT)
        assert np.linalg.norm(theta) <= FURTHEST_RAD + 1e-9


def block(height=2e-3, wide=12e-3):
    """Bone that fills z < 0 [m]."""
    counts = (round(wide / SPACING), round(wide / SPACING), round(2.0 * height / SPACING))
    fraction = np.zeros(counts, dtype=np.uint8)
    fraction[:, :, : counts[2] // 2] = FULL
    return VoxelVolume(
        origin_m=np.array([-0.5 * wide, -0.5 * wide, -height]),
        spacing_m=SPACING,
        fraction=fraction,
        density_kg_m3=np.full(counts, 1900, dtype=np.uint16),
        layer=np.zeros(counts, dtype=np.uint8),
        layer_names=("cortical",),
    )


def probe(profile, *, start, points=400, axis=(0.0, 0.0, 1.0), **tool):
    """Tool on the block, its tissue and a motion at its start."""
    cutter = Cutter(profile, 4, 0.0)
    held = ProbingTool(2e3, np.array(start), **tool)
    shell = ToolShell.of_cutter(cutter, point_count=points)
    bone = ProbedBone(block(), shell, area_m2=cutter.cutting_area_m2, tool=held)
    motion = ToolMotion(rotation=frame_along(axis))
    motion.tip_m[:] = start
    bone.place(motion)
    return held, bone, motion


def press(held, bone, motion, path, quaternion=UPRIGHT):
    """Lead the device along positions; the last response."""
    response = Response.empty(1)
    for device in path:
        motion.tip_m[:] = held.follow(np.asarray(device), quaternion, np.zeros(6), response, STEP_S)
        response = bone.respond(motion)
    return response


def down(start, end, steps=120):
    return np.linspace(start, end, steps)


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [0.3e-3, 2e-3, 20e-3])
def test_a_stopped_burr_on_bone_pushes_with_stiffness_times_stretch(depth_m):
    held, bone, motion = probe(ball_burr(diameter_m=6e-3), start=(0, 0, 1e-3))
    response = press(held, bone, motion, down((0, 0, 1e-3), (0, 0, -depth_m)))
    # half a voxel, and what the shell's points miss of the tip
    assert abs(motion.tip_m[2]) < 0.6 * SPACING
    np.testing.assert_allclose(
        response.wrench[:3], 2e3 * (motion.tip_m - depth_m * DOWN), atol=2e3 * 1e-3 * SPACING
    )
    np.testing.assert_allclose(response.wrench[2], 2e3 * depth_m, rtol=0.15)
    assert (
        response.measures[0] >= 1 and response.measures[1] == 0.0 and response.engaged_m2[0] > 0.0
    )
    assert bone.removed_m3.sum() == 0.0
    np.testing.assert_allclose(bone.start_m3, 12e-3 * 12e-3 * 2e-3, rtol=1e-6)


def test_a_stopped_tool_sticks_inside_the_cone_and_slides_beyond_it():
    """A stopped tool sticks inside the cone and slides beyond it.

    The device moves aside by s at depth d: the contact holds while s < mu d, then pulls with mu
    times the normal.
    """
    held, bone, motion = probe(ball_burr(diameter_m=6e-3), start=(0, 0, 1e-3))
    press(held, bone, motion, down((0, 0, 1e-3), (0, 0, -2e-3)))
    at = motion.tip_m.copy()
    press(held, bone, motion, down((0, 0, -2e-3), (0.4e-3, 0, -2e-3)))
    assert np.linalg.norm(motion.tip_m - at) < 0.5 * SPACING
    response = press(held, bone, motion, down((0.4e-3, 0, -2e-3), (4e-3, 0, -2e-3)))
    assert motion.tip_m[0] > 2e-3
    np.testing.assert_allclose(-response.wrench[0] / response.wrench[2], 0.3, rtol=0.15)


def test_a_tool_inside_the_bone_is_refused():
    with pytest.raises(InputError, match=r"motion must start outside the bone, got .* mm deep"):
        probe(ball_burr(diameter_m=6e-3), start=(0, 0, -1e-3))
