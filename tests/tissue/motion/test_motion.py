"""Motion of the tool, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue import InputError
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.motion import FollowPath, frame_along, matrix_of, quaternion_of
from tissue.motion.quaternion import (
    conjugate,
    exponential,
    logarithm,
    of_matrix,
    product,
    turn_between,
    unit,
)
from tissue.motion.replay import GivenPoses, ReplayPoses, read_replay
from tissue.motion.thrust import PushAlongAxis

STEP_S = 1e-3
Z = (0.0, 0.0, 1.0)
ROUNDING = 1e-12
"""Of lengths of a few centimetres [m]: a few hundred roundings of 1e-17."""


def ticks(motion, count, response=None):
    """Tip, rotation, heading and speed of each tick."""
    tool, response = ToolMotion(), response or Response.empty(1)
    poses = []
    for index in range(count):
        motion.advance(index * STEP_S, STEP_S, response, tool)
        poses.append((tool.tip_m.copy(), tool.rotation.copy(), tool.heading.copy(), tool.speed_m_s))
    return tuple(np.array(column) for column in zip(*poses, strict=True))


@pytest.mark.parametrize(
    "axis", [*np.random.default_rng(0).normal(size=(50, 3)), (1, 0, 0), (0, 0, -2)]
)
def test_frame_along_is_right_handed_with_its_axis_third(axis):
    frame = frame_along(axis)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(frame[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-15)


def test_a_path_meets_its_corners_exactly_at_its_feed():
    corners = np.array([[0, 0, 0.5], [0, 0, -1.5], [3, 0, -1.5], [3, 0, -1.5], [3, 4, -1.5]]) * 1e-3
    motion = FollowPath(corners, feed_m_s=0.1, axis=Z)
    assert motion.duration_s == pytest.approx(0.09, abs=1e-15)
    tips, rotations, headings, speeds = ticks(motion, 120)
    for tick, corner in ((0, 0), (20, 1), (50, 2), (90, 4), (119, 4)):
        np.testing.assert_allclose(tips[tick], corners[corner], atol=1e-15)
    np.testing.assert_array_equal(rotations, np.broadcast_to(np.eye(3), rotations.shape))
    for ticks_of, heading in (
        (slice(0, 21), (0, 0, -1)),
        (slice(21, 51), (1, 0, 0)),
        (slice(51, 91), (0, 1, 0)),
    ):
        np.testing.assert_allclose(
            headings[ticks_of, 0], np.broadcast_to(heading, headings[ticks_of, 0].shape)
        )
    assert not headings[:, 1].any()
    assert (speeds[:91] == 0.1).all() and (speeds[91:] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(np.diff(tips, axis=0), axis=1)[:90], 1e-4, atol=1e-15)


def push(**changes):
    settings = {
        "axis": Z,
        "thrust_N": 2.0,
        "mass_kg": 0.5,
        "max_feed_m_s": 0.1,
        "depth_m": 5e-3,
    } | changes
    return PushAlongAxis(np.array([1e-3, 0.0, 5e-3]), **settings)


def test_free_flight_gains_speed_as_thrust_over_mass_up_to_the_largest_feed_and_stops_at_depth():
    tips, _, headings, speeds = ticks(push(), 200)
    # Implicit Euler under a constant force: v_n = n dt F / m, exactly.
    np.testing.assert_allclose(speeds[:25], STEP_S * 2.0 / 0.5 * np.arange(1, 26), rtol=1e-12)
    assert speeds.max() == 0.1
    np.testing.assert_allclose(tips[1:, 2] - tips[:-1, 2], -speeds[1:] * STEP_S, atol=1e-15)
    assert (tips[:, :2] == (1e-3, 0.0)).all()
    np.testing.assert_allclose(headings[:, 0], np.broadcast_to((0, 0, -1), (200, 3)))
    assert tips[-1, 2] == pytest.approx(-5e-3, abs=ROUNDING)
    assert tips[:, 2].min() >= -5e-3 - ROUNDING
    assert speeds[-1] == pytest.approx(0.0, abs=1e-12)


def test_a_viscous_tissue_sets_the_feed_that_balances_the_thrust():
    response = Response.empty(1)
    response.resistance[2], response.edge[2] = 400.0, 0.5
    _, _, _, speeds = ticks(push(depth_m=1.0), 300, response)
    decay = 1.0 / (1.0 + 400.0 * STEP_S / 0.5)
    balance = (2.0 - 0.5) / 400.0
    np.testing.assert_allclose(speeds, balance * (1.0 - decay ** np.arange(1, 301)), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_push_never_moves_backward(seed):
    """A push never moves backward for any response of the tissue.

    Steps past the stability limit of an explicit step are among them.
    """
    random = np.random.default_rng(seed)
    motion, response, tool = (
        push(thrust_N=20.0, max_feed_m_s=0.2, depth_m=2e-3),
        Response.empty(1),
        ToolMotion(),
    )
    travelled = []
    for index in range(2000):
        response.resistance[:3] = random.normal(size=3) * 10.0 ** random.uniform(0, 6)
        response.edge[:3] = random.normal(size=3) * 30.0
        motion.advance(index * STEP_S, STEP_S, response, tool)
        assert 0.0 <= tool.speed_m_s <= 0.2
        travelled.append(5e-3 - tool.tip_m[2])
    assert (np.diff(travelled) >= 0.0).all()
    assert travelled[-1] == pytest.approx(7e-3, abs=1e-9)


def test_an_edge_force_above_the_thrust_holds_the_tool():
    response = Response.empty(1)
    response.edge[2] = 2.5
    tips, _, _, speeds = ticks(push(), 50, response)
    assert (speeds == 0.0).all() and np.ptp(tips, axis=0).max() == 0.0


def test_a_table_of_constant_rotation_turns_at_that_rate():
    """A table of constant rotation turns at that rate.

    Slerp between poses 50 ms apart follows a constant rate exactly, up to rounding of its tick
    differences.
    """
    rate, axis = 3.0, np.array([1.0, 2.0, 2.0]) / 3.0
    times = np.arange(0.0, 1.01, 0.05)
    turns = Rotation.from_rotvec(rate * times[:, None] * axis)
    velocity = np.array([2e-3, 0.0, -1e-3])
    motion = ReplayPoses(times, times[:, None] * velocity, turns.as_quat())
    assert motion.duration_s == pytest.approx(1.0)
    tips, rotations, headings, speeds = ticks(motion, 1001)
    at = STEP_S * np.arange(1001)
    np.testing.assert_allclose(tips, at[:, None] * velocity, atol=ROUNDING)
    np.testing.assert_allclose(
        rotations, Rotation.from_rotvec(rate * at[:, None] * axis).as_matrix(), atol=1e-9
    )
    np.testing.assert_allclose(
        headings[1:, 0] * speeds[1:, None], np.broadcast_to(velocity, (1000, 3)), atol=1e-11
    )
    np.testing.assert_allclose(
        headings[1:, 1] * speeds[1:, None], np.broadcast_to(rate * axis, (1000, 3)), atol=1e-8
    )
    assert speeds[0] == 0.0


def test_a_table_reads_in_its_units_whatever_the_order_of_columns_and_the_first_time(tmp_path):
    (tmp_path / "poses.csv").write_text(
        "tool_qw,note,tool_qx,tool_qy,tool_qz,tool_x_mm,tool_y_mm,tool_z_mm,time_s\n"
        "1,a,0,0,0,1,2,3,10.0\n1,b,0,0,0,2,2,3,10.5\n"
    )
    motion = read_replay(tmp_path / "poses.csv")
    tips, _, _, speeds = ticks(motion, 501)
    np.testing.assert_allclose(
        tips[[0, 250, 500]], [[1e-3, 2e-3, 3e-3], [1.5e-3, 2e-3, 3e-3], [2e-3, 2e-3, 3e-3]]
    )
    np.testing.assert_allclose(speeds[1:], 2e-3, rtol=1e-9)


def test_a_table_in_other_units_and_with_equal_times_is_read(tmp_path):
    """A semicolon between columns, decimal commas, metres, milliseconds, and a repeated sample."""
    (tmp_path / "poses.csv").write_text(
        "Time [ms];tool_x [m];tool_y [m];tool_z [m];tool_qx;tool_qy;tool_qz;tool_qw\n"
        "0,0;0,001;0,002;0,003;0;0;0;1\n0,0;0,001;0,002;0,003;0;0;0;1\n"
        "500,0;0,002;0,002;0,003;0;0;0;1\n",
        "utf-16",
    )
    motion = read_replay(tmp_path / "poses.csv")
    tips, _, _, speeds = ticks(motion, 501)
    np.testing.assert_allclose(tips[[0, 500]], [[1e-3, 2e-3, 3e-3], [2e-3, 2e-3, 3e-3]])
    np.testing.assert_allclose(speeds[1:], 2e-3, rtol=1e-9)
    assert motion.notes == ("1 pose left out with the same time as the pose before",)


def test_a_path_of_one_point_is_refused():
    with pytest.raises(
        InputError, match="must contain at least two different points, got only one"
    ):
        FollowPath(np.zeros((3, 3)), feed_m_s=1.0, axis=Z)


def test_matrices_and_quaternions_agree_with_scipy():
    for rotation in [
        *Rotation.random(50, random_state=1),
        *(Rotation.from_rotvec(v) for v in np.pi * np.eye(3)),
    ]:
        quaternion = quaternion_of(rotation.as_matrix())
        assert matrix_of(quaternion) == pytest.approx(rotation.as_matrix(), abs=1e-14)
        assert quaternion[3] >= 0.0
        other = Rotation.random(random_state=2)
        expected = (other * rotation.inv()).as_rotvec()
        assert np.array(turn_between(quaternion, other.as_quat())) == pytest.approx(
            expected, abs=1e-12
        )


def test_given_poses_begin_at_rest_at_the_first_one():
    """A tool has no direction before its first step, whatever the first step is."""
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.1], [0.0, 0.3, 0.0], [0.2, 0.0, 0.0]])
    tips = np.array([[1e-3, 2e-3, 3e-3], [2e-3, 2e-3, 3e-3], [2e-3, 4e-3, 3e-3]])
    given, motion = GivenPoses(np.array([0.0, 1e-3, 2e-3]), tips, turns), ToolMotion()
    motion.heading[:] = 1.0
    given.begin(motion)
    assert motion.tip_m == pytest.approx(tips[0]) and motion.rotation == pytest.approx(
        turns[0].as_matrix()
    )
    assert not motion.heading.any()
    given.advance(2e-3, 1e-3, Response.empty(1), motion)
    turned = (turns[2] * turns[1].inv()).as_rotvec()
    assert motion.speed_m_s == pytest.approx(2.0)
    assert motion.heading == pytest.approx(np.array([[0.0, 1.0, 0.0], turned / 2e-3]))
    given.advance(3e-3, 1e-3, Response.empty(1), motion)
    assert motion.speed_m_s == 0.0 and motion.tip_m == pytest.approx(tips[2])


EXTREME = [
    *np.zeros((1, 3)),
    *(np.pi * np.eye(3)),
    *(1e-9 * np.eye(3)),
    *(0.7 * np.eye(3)),
    *(-3.1 * np.eye(3)),
]
"""Rotation vectors [rad]: none, half turns about the axes, tiny, plain and nearly full ones."""


def same_rotation(found, wanted):
    """Return True if two unit quaternions are one rotation: equal, or of opposite sign."""
    sign = 1.0 if np.dot(found, wanted) > 0.0 else -1.0
    return sign * np.array(found) == pytest.approx(np.array(wanted), abs=1e-12)


@pytest.mark.parametrize("vector", [*EXTREME, *np.random.default_rng(3).normal(size=(30, 3))])
def test_rotations_inside_the_tick_agree_with_scipy(vector):
    rotation, other = Rotation.from_rotvec(vector), Rotation.from_rotvec([0.4, -1.2, 0.9])
    wanted, second = tuple(rotation.as_quat()), tuple(other.as_quat())
    assert same_rotation(of_matrix(rotation.as_matrix().tolist()), wanted)
    assert same_rotation(exponential(tuple(vector)), wanted)
    assert same_rotation(product(second, wanted), (other * rotation).as_quat())
    assert same_rotation(conjugate(wanted), rotation.inv().as_quat())
    negative = tuple(-component for component in second)
    assert logarithm(negative) == pytest.approx(other.as_rotvec(), abs=1e-12)
    assert np.linalg.norm(logarithm(wanted)) == pytest.approx(rotation.magnitude(), abs=1e-12)
    assert unit(tuple(5.0 * component for component in wanted)) == pytest.approx(wanted, abs=1e-15)
    assert unit((0.0, 0.0, 1e-7, 0.0)) is None and unit((np.inf, 0.0, 0.0, 0.0)) is None


def test_a_position_in_another_unit_is_refused_before_anything_is_carved(tmp_path):
    columns = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    path = tmp_path / "poses.csv"
    path.write_text(f"{columns}\n0,0,0,1,0,0,0,1\n1,0,0,1e9,0,0,0,1\n")
    with pytest.raises(
        InputError, match=r"motion\.file must lie within 10 m of each other, got 1e\+06 m"
    ):
        read_replay(path)
    tips = np.array([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    assert GivenPoses(np.array([0.0, 1.0]), tips, Rotation.identity(2)).duration_s == 1.0
