"""A motion by a hand, tick by tick: what it plays, and where the tool is, in closed form."""

import numpy as np
import pytest
from ball_cut import CutElements, damping_N_s_m
from hand_steps import STEP_S, held, meet
from quiet_press import LIMITS, PERSON, check_ripple, quiet_press

from tissue.haptics import hand_measures as at
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.hand_measures import MEASURES, PERCEIVED, PREDICTED
from tissue.haptics.loop.critical_stiffness import judge
from tissue.models.tissue_model import FreeSpace, Response, ToolMotion, WallModel
from tissue.motion.quaternion import logarithm

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("law", ["proxy", "penalty"])
def test_in_free_space_the_tool_is_where_the_device_is_and_nothing_is_played(law):
    tips, measures, _ = meet(held("wall", device="touch", renderer=law), FreeSpace(), 1.0)
    np.testing.assert_array_equal(1e3 * tips, measures[:, :3])
    assert np.ptp(tips, axis=0).max() > 1e-3
    assert not measures[:, 7:17].any()


def test_in_free_space_the_inertia_of_a_cutting_tool_is_played():
    """In free space the inertia of a cutting tool is played.

    The device has a constant acceleration a, which the observer follows without delay. Spring and
    damper then have the force m a at the tool. The velocity of the tool is that of the middle of a
    tick, the observed one that of its end, so that the damper has the share b a T / 2.
    """
    acceleration, factor = np.array([0.3, -0.2, 0.1]), 0.03
    motion = held("milling", device="touch", coupling__force_scale=factor)
    times = STEP_S * np.arange(401)
    path = motion.tool.tip_m + 0.5 * times[:, None] ** 2 * acceleration
    motion.device = RecordedDevice(times, path)
    tips, measures, _ = meet(motion, FreeSpace(), 0.4)
    pull = (motion.tool.mass_kg - 0.5 * damping_N_s_m(motion.tool) * STEP_S) * acceleration
    stretch = path[400 - 1] - tips[-1]
    np.testing.assert_allclose(motion.tool.stiffness_N_m * stretch, pull, rtol=1e-6)
    np.testing.assert_allclose(measures[-1, at.RAW_FORCE], -factor * pull, rtol=1e-6)


@pytest.mark.parametrize(("share", "settles"), [(0.95, True), (1.05, False)])
def test_the_whole_loop_is_stable_up_to_the_stiffness_that_is_judged(share, settles):
    """The whole loop is stable up to the stiffness that is judged.

    The loop has device, tool on the wall, renderer, low-pass and delay, 5 % on either side of the
    eigenvalues' critical stiffness. It leaves out friction, encoders, noise and reflex, as the
    judge does. Coupling and wall are springs in series.
    """
    wall = 2e4
    critical = judge(LIMITS.loop(1.0, filter_s=1e-3), [PERSON.grip[:3]]).critical_N_m
    loop = LIMITS.loop(1.0 / (1.0 / (share * critical) - 1.0 / wall), filter_s=1e-3)
    _, measures, _ = meet(
        quiet_press(loop, margin=1.0 - share), WallModel(wall, radius_m=5e-3), 2.0
    )
    check_ripple(measures, settles=settles)


def test_a_delay_holds_the_force_back_by_whole_ticks():
    tips, measures, _ = meet(
        held(coupling__delay_ms=7, output__low_pass_ms=0.0), WallModel(1e4, radius_m=5e-3), 0.8
    )
    stretch, filtered = 1e3 * tips[:, 2] - measures[:, 2], measures[:, 15]
    touched, answered = np.flatnonzero(stretch > 0.0)[0], np.flatnonzero(filtered)[0]
    assert answered == touched + 7


@pytest.mark.parametrize("speed_m_s", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("wall_N_m", [1e3, 1e4, 4e4])
def test_the_first_contact_is_answered_in_its_tick_and_without_a_spike(speed_m_s, wall_N_m):
    """The first contact gives a force in its tick and without a spike.

    Spring and wall act in series from the first tick on: F = depth of the device / (1 / k_c + 1 /
    k_w).
    """
    motion = held(motion__feed_mm_s=1e3 * speed_m_s, coupling__force_scale=1.0)
    times = np.array([0.0, 0.3])
    down = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02 - 0.3 * speed_m_s]])
    motion.device = RecordedDevice(times, down)
    _, measures, forces = meet(motion, WallModel(wall_N_m, radius_m=5e-3), 0.3)
    depth = np.maximum(-1e-3 * measures[:, 2], 0.0)
    assert (depth > 0.0).sum() > 50
    np.testing.assert_allclose(
        forces[:, 2], depth / (1.0 / 400.0 + 1.0 / wall_N_m), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(measures[:, 21], forces[:, 2], rtol=1e-9, atol=1e-12)


class CutBlock(FreeSpace):
    """Material below a height that resists with an edge force and a drag against its normal."""

    def __init__(self, top_m, *, drag_N_s_m, edge_N):
        super().__init__()
        self.milling = BlockElement(top_m, UP, drag_N_s_m, edge_N)

    def respond(self, motion):
        self._response.wrench[:] = motion.balanced
        return self._response


class BlockElement(CutElements):
    """One element that points down."""

    def __init__(self, top_m, up, drag_N_s_m, edge_N):
        super().__init__(-up, -drag_N_s_m * up, -edge_N * up)
        self.top_m = top_m

    def gaps(self, points_m, normals):
        return self.top_m - points_m[:, 2]


@pytest.mark.parametrize("speed_m_s", [0.05, 0.2])
def test_a_cutter_that_meets_bone_is_slowed_in_the_same_tick(speed_m_s):
    """A cutter that touches bone is slowed in that tick.

    A cut at the speed of the device would need the force v c, which is above 1 kN. From the first
    tick in contact, the force is the pull of spring and damper and the momentum lost in the tick.
    """
    drag, edge, factor = 2e4, 5.0, 0.03
    motion = held("glenoid", device="touch", coupling__force_scale=factor)
    tool = motion.tool
    start = tool.tip_m.copy()
    times = STEP_S * np.arange(301)
    path = start - speed_m_s * times[:, None] * UP
    motion.device = RecordedDevice(times, path)
    block = CutBlock(start[2] - 0.2 * speed_m_s, drag_N_s_m=drag, edge_N=edge)
    tips, _, forces = meet(motion, block, 0.3)
    first = int(np.flatnonzero(forces[:, 2])[0])
    assert 195 <= first <= 205 and drag * speed_m_s > 999.0
    speeds = np.diff(tips[:, 2], prepend=start[2]) / STEP_S
    lost = tool.mass_kg * np.diff(speeds, prepend=0.0) / STEP_S
    spring = tool.stiffness_N_m * (path[: len(tips), 2] - tips[:, 2])
    damper = damping_N_s_m(tool) * (-speed_m_s - speeds)
    late = slice(first, None)
    # The observer starts at rest. Its error after 0.2 s is 0.014 N for each m/s; it falls with time.
    np.testing.assert_allclose(
        forces[late, 2], (lost - spring - damper)[late], rtol=0.0, atol=0.015 * speed_m_s
    )
    assert np.abs(forces[first, 2]) < 0.25 * drag * speed_m_s
    # In steady cutting the tool has the speed of the device.
    assert speeds[first] < 0.0 and (speeds <= 1e-9).all()


def test_torque_turns_the_tool_until_the_spring_balances_it_and_is_played():
    """Torque turns the tool until the spring balances it, and is played.

    A ball rolled aside of its tip on the wall has arm x F of the wall = k_r theta, at the device
    scaled by f / m.
    """
    tilt, scale, motion_factor = 0.3, 0.5, 2.0
    changes = {
        "coupling__stiffness_Nm_rad": 0.2,
        "coupling__force_scale": scale,
        "coupling__motion_scale": motion_factor,
    }
    motion = held(device="six-dof", motion__axis=[np.sin(tilt), 0, np.cos(tilt)], **changes)
    motion.device = RecordedDevice(
        np.array([0.0, 0.5, 1.5]), np.array([[0, 0, 20e-3], [0, 0, 7e-3], [0, 0, 7e-3]])
    )
    tool, response, wall = ToolMotion(), Response.empty(1), WallModel(1e4, radius_m=5e-3)
    motion.begin(tool)
    for index in range(1500):
        motion.advance(index * STEP_S, STEP_S, response, tool)
        response = wall.respond(tool)
        if motion.correct(response, tool):
            response = wall.respond(tool)
        motion.play(response)
    theta = np.array(logarithm(motion.tool.quaternion))
    assert abs(response.wrench[4]) > 5e-3
    np.testing.assert_allclose(
        0.2 * theta, scale / motion_factor * response.wrench[3:], rtol=1e-3, atol=1e-9
    )
    np.testing.assert_allclose(
        motion.measures[10:13], scale / motion_factor * response.wrench[3:], rtol=1e-2, atol=1e-9
    )
    np.testing.assert_allclose(
        motion.measures[7:10], scale * response.wrench[:3], rtol=1e-3, atol=1e-9
    )


def test_every_measure_lies_at_its_place():
    columns = MEASURES + PREDICTED + PERCEIVED
    for place, start in (
        (at.POSITION, "device_x_mm"),
        (at.QUATERNION, "device_qx"),
        (at.PLAYED_FORCE, "device_force_x_N"),
        (at.PLAYED_TORQUE, "device_torque_x_Nm"),
        (at.FILTERED_FORCE, "filtered_force_x_N"),
        (at.RAW_FORCE, "raw_force_x_N"),
        (at.PREDICTED_FORCE, "predicted_force_x_N"),
    ):
        assert (
            columns[place][0] == start and len({name.split("_")[0] for name in columns[place]}) == 1
        )
    single = {
        at.SATURATED: "saturated",
        at.ENERGY: "passivity_J",
        at.MARGIN: "margin",
        at.RESIDUAL: PREDICTED[3],
        at.PREDICTED_BY: PREDICTED[4],
    }
    assert all(columns[place] == name for place, name in single.items())
