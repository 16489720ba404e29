"""One step of a descent against NumPy: halved, free, shortened, and projected on a plane."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.proxy_contacts import Contacts
from kernels.proxy_descent import (
    AT_REST,
    GOES_ON,
    OUT_OF_SOLVES,
    Descent,
    DescentSettings,
    Reaction,
    accept_trial,
    aim_at,
    halve_motion,
    motion_length,
    pose_distance,
    take_step,
    turn_between,
    turned_by,
)
from kernels.proxy_forces import MEMBERS

EXACT = 1e-9
"""Tolerance of lengths and angles of size one.

The contact's matrix is stiffened by 1e-13, and rounding is 1e-15.
"""
REACH, STEP, TOLERANCE = 0.7, 0.5, 1e-6


@wp.kernel
def step_once(
    settings: DescentSettings,
    start: wp.transformd,
    motion: wp.array(dtype=wp.vec3d),  # shift and turn of the trial
    goal: wp.transformd,
    gap: wp.float64,
    clear: wp.float64,
    solves: int,
    contacts_out: Contacts,
    halved_out: wp.array(dtype=wp.transformd),
    vector_out: wp.array(dtype=wp.vec3d),
    trial_out: wp.array(dtype=wp.transformd),
    number_out: wp.array(dtype=wp.float64),
):
    before = Descent()
    before.position = wp.transform_get_translation(start)
    before.rotation = wp.transform_get_rotation(start)
    before.shift = motion[0]
    before.turn = motion[1]
    before.solves = solves
    before.near = settings.tolerance
    before.lowest = wp.float64(1.0e300)
    half = halve_motion(before, wp.float64(REACH))
    halved_out[0] = wp.transformd(half.trial_position, half.trial_rotation)
    number_out[0] = half.travel
    before.trial_position = before.position
    before.trial_rotation = before.rotation
    accepted = accept_trial(before, gap, settings.step)
    number_out[1] = accepted.deepest
    descent, reaction, ended = take_step(
        accepted,
        Reaction(),
        contacts_out,
        1,
        settings,
        wp.transform_get_translation(goal),
        wp.transform_get_rotation(goal),
        gap,
        clear,
        wp.float64(0.0),
        wp.float64(REACH),
    )
    vector_out[0] = descent.shift
    vector_out[1] = descent.turn
    vector_out[2] = reaction.force
    vector_out[3] = reaction.moment
    vector_out[4] = reaction.centre
    trial_out[0] = wp.transformd(descent.trial_position, descent.trial_rotation)
    number_out[2] = descent.travel
    number_out[3] = wp.float64(ended)
    number_out[4] = wp.float64(descent.arrived)
    number_out[5] = wp.float64(reaction.pressing)


def one_contact(arm, normal, gap):
    """Return the arrays of one possible contact."""
    contacts = Contacts()
    contacts.slots = 1
    for name, values, dtype in (
        ("normal_force", [0.0], wp.float64),
        ("slot", [0], wp.int32),
        ("chosen", [0], wp.int32),
        ("gap", [gap], wp.float64),
        ("arm", [arm], wp.vec3d),
        ("normal", [normal], wp.vec3d),
        ("moment", [np.cross(arm, normal)], wp.vec3d),
        ("member", np.zeros(MEMBERS), wp.int32),
        ("lower", np.zeros((MEMBERS, MEMBERS)), wp.float64),
        ("side", np.zeros((MEMBERS, 3)), wp.float64),
    ):
        setattr(contacts, name, wp.array(values, dtype=dtype, device="cpu"))
    return contacts


class Case:
    """A random pose, goal and plane; the kernel's step from there."""

    def __init__(self, seed, *, compliance, gap, clear=10.0, solves=0):
        random = np.random.default_rng(seed)
        self.start, self.goal = random.normal(size=(2, 3))
        self.turns = (
            Rotation.random(random_state=seed),
            Rotation.from_rotvec(random.normal(size=3) * 0.4),
        )
        self.shift = self.goal - self.start
        self.turn = self.turns[1].as_rotvec() if compliance else np.zeros(3)
        self.motion = random.normal(size=(2, 3)) * [[1.0], [float(compliance > 0.0)]]
        self.arm = random.normal(size=3)
        self.normal = random.normal(size=3) - 2.0 * self.shift
        self.normal /= np.linalg.norm(self.normal)
        settings = DescentSettings()
        settings.compliance, settings.step, settings.tolerance = compliance, STEP, TOLERANCE
        settings.step_limit, settings.solve_limit = 9, 9
        goal = wp.transformd(self.goal, (self.turns[1] * self.turns[0]).as_quat())
        start = wp.transformd(self.start, self.turns[0].as_quat())
        out = [
            wp.zeros(1, dtype=wp.transformd, device="cpu"),
            wp.zeros(5, dtype=wp.vec3d, device="cpu"),
            wp.zeros(1, dtype=wp.transformd, device="cpu"),
            wp.zeros(6, dtype=wp.float64, device="cpu"),
        ]
        motion = wp.array(self.motion, dtype=wp.vec3d, device="cpu")
        inputs = [
            settings,
            start,
            motion,
            goal,
            gap,
            clear,
            solves,
            one_contact(self.arm, self.normal, gap),
        ]
        wp.launch(step_once, dim=1, inputs=inputs, outputs=out, device="cpu")
        self.halved, self.vectors, self.trial, self.numbers = (each.numpy() for each in out)

    def check_pose(self, found, shift, turn):
        """A pose is the start moved by a shift and a turn."""
        right = (Rotation.from_rotvec(turn) * self.turns[0]).as_matrix()
        assert found[0, :3] == pytest.approx(self.start + shift, abs=EXACT)
        assert Rotation.from_quat(found[0, 3:]).as_matrix() == pytest.approx(right, abs=EXACT)


def length(shift, turn):
    return np.linalg.norm(shift) + REACH * np.linalg.norm(turn)


def test_a_halved_motion_and_an_accepted_pose():
    for seed in range(5):
        case = Case(seed, compliance=1.5, gap=-0.2)
        shift, turn = 0.5 * case.motion
        case.check_pose(case.halved, shift, turn)
        assert case.numbers[0] == pytest.approx(length(shift, turn), abs=EXACT)
        assert case.numbers[1] == -0.2  # deeper than a tenth of a step: the next may not be deeper


@pytest.mark.parametrize("compliance", [0.0, 1.5])
@pytest.mark.parametrize("clear", [10.0, 0.3])
def test_a_free_motion_arrives_or_is_shortened(compliance, clear):
    for seed in range(5):
        case = Case(seed, compliance=compliance, gap=50.0, clear=clear)
        share = min(clear / length(case.shift, case.turn), 1.0)
        assert case.vectors[:2] == pytest.approx(
            share * np.array([case.shift, case.turn]), abs=EXACT
        )
        assert case.numbers[2] == pytest.approx(share * length(case.shift, case.turn), abs=EXACT)
        assert case.numbers[3:].tolist() == [GOES_ON, float(share == 1.0), 0.0]
        case.check_pose(case.trial, share * case.shift, share * case.turn)
        assert not case.vectors[2:].any()


@pytest.mark.parametrize("compliance", [0.0, 1.5])
def test_a_motion_into_a_plane_ends_on_it(compliance):
    """With one plane, f = -(g + n . t + m . w) / (n . n + c m . m), t' = t + f n, w' = w + c f
    m.
    """
    for seed in range(5):
        case = Case(seed, compliance=compliance, gap=0.05)
        moment = np.cross(case.arm, case.normal)
        normal_force = -(0.05 + case.normal @ case.shift + moment @ case.turn) / (
            1.0 + compliance * moment @ moment
        )
        assert normal_force > 0.0
        force = normal_force * case.normal
        shift, turn = case.shift + force, case.turn + compliance * normal_force * moment
        assert case.vectors == pytest.approx(
            np.array([shift, turn, force, normal_force * moment, case.arm]), abs=EXACT
        )
        assert case.numbers[3:].tolist() == [GOES_ON, 0.0, 1.0]
        case.check_pose(case.trial, shift, turn)


def test_a_step_ends_at_rest_or_where_its_solves_have_run_out():
    assert Case(0, compliance=0.0, gap=50.0, solves=9).numbers[3] == OUT_OF_SOLVES
    case = Case(0, compliance=0.0, gap=0.05)
    assert case.numbers[3] == GOES_ON != AT_REST


@wp.kernel
def aim_often(
    start: wp.transformd,
    goal: wp.transformd,
    compliance: wp.float64,
    spacing: wp.float64,
    numbers_out: wp.array2d(dtype=wp.float64),
):
    descent = Descent()
    descent.position = wp.transform_get_translation(start)
    descent.rotation = wp.transform_get_rotation(start)
    descent.lowest = wp.float64(1.0e300)
    for k in range(numbers_out.shape[0]):
        descent = aim_at(
            descent,
            wp.transform_get_translation(goal),
            wp.transform_get_rotation(goal),
            compliance,
            spacing,
        )
        numbers_out[k, 0] = wp.float64(descent.stalls)
        numbers_out[k, 1] = descent.lowest
        if k == 3:  # halfway there, the springs' energy has fallen to a quarter
            descent.position = wp.float64(0.5) * (
                descent.position + wp.transform_get_translation(goal)
            )


@pytest.mark.parametrize(("spacing", "stalls"), [(1e-4, [0, 1, 2, 3, 0, 1]), (0.0, [0] * 6)])
def test_steps_that_leave_the_springs_energy_are_counted_as_stalls_near_voxels(spacing, stalls):
    """The energy is |shift|^2 + |turn|^2 / c; it is the lowest so far that counts."""
    start, goal, compliance = np.array([1.0, -2.0, 0.5]), np.array([0.2, 0.3, 0.4]), 1.5
    turn = Rotation.from_rotvec([0.3, -0.1, 0.2])
    out = wp.zeros((6, 2), dtype=wp.float64, device="cpu")
    poses = wp.transformd(start, [0.0, 0.0, 0.0, 1.0]), wp.transformd(goal, turn.as_quat())
    wp.launch(aim_often, dim=1, inputs=[*poses, compliance, spacing], outputs=[out], device="cpu")
    far, turned = np.sum((goal - start) ** 2), turn.magnitude() ** 2 / compliance
    assert out.numpy()[:, 0].tolist() == stalls
    assert out.numpy()[:, 1] == pytest.approx(
        [far + turned] * 4 + [0.25 * far + turned] * 2, abs=EXACT
    )


ROUNDING = 1e-12
"""Tolerance of angles up to pi.

Near a half turn the rotation vector is known to the root of rounding, so such turns are left out.
"""


COUNT = 300


@wp.kernel
def evaluate(
    start: wp.array(dtype=wp.quatd),
    turn: wp.array(dtype=wp.vec3d),
    place: wp.array2d(dtype=wp.vec3d),
    reach: wp.float64,
    goal_out: wp.array(dtype=wp.quatd),
    turn_out: wp.array(dtype=wp.vec3d),
    length_out: wp.array2d(dtype=wp.float64),
):
    i = wp.tid()
    goal = turned_by(turn[i], start[i])
    goal_out[i] = goal
    turn_out[i] = turn_between(start[i], -goal)
    length_out[i, 0] = motion_length(place[i, 1] - place[i, 0], turn[i], reach)
    length_out[i, 1] = pose_distance(place[i, 0], start[i], place[i, 1], goal, reach)
    length_out[i, 2] = pose_distance(place[i, 0], start[i], place[i, 1], goal, wp.float64(0.0))


def test_turns_and_lengths():
    """Turns have the right length from 1e-12 to almost a half turn.

    The shortest turn between q and -q equals the one between q and q.
    """
    random, reach = np.random.default_rng(0), 0.03
    start = Rotation.random(COUNT, random_state=1)
    turn = random.normal(size=(COUNT, 3))
    turn *= (10.0 ** random.uniform(-12.0, 0.49, COUNT) / np.linalg.norm(turn, axis=1))[:, None]
    turn[0] = 0.0
    place = random.normal(size=(COUNT, 2, 3))
    given = [
        wp.array(start.as_quat(), dtype=wp.quatd, device="cpu"),
        wp.array(turn, dtype=wp.vec3d, device="cpu"),
    ]
    given.append(wp.array(place, dtype=wp.vec3d, device="cpu"))
    goal, found = (
        wp.zeros(COUNT, dtype=wp.quatd, device="cpu"),
        wp.zeros(COUNT, dtype=wp.vec3d, device="cpu"),
    )
    length = wp.zeros((COUNT, 3), dtype=wp.float64, device="cpu")
    wp.launch(
        evaluate, dim=COUNT, inputs=[*given, reach], outputs=[goal, found, length], device="cpu"
    )
    right = (Rotation.from_rotvec(turn) * start).as_matrix()
    assert Rotation.from_quat(goal.numpy()).as_matrix() == pytest.approx(right, abs=ROUNDING)
    assert found.numpy() == pytest.approx(turn, abs=ROUNDING)
    path, angle = np.linalg.norm(place[:, 1] - place[:, 0], axis=1), np.linalg.norm(turn, axis=1)
    expected = np.column_stack([path + reach * angle, path + reach * angle, path])
    assert length.numpy() == pytest.approx(expected, abs=ROUNDING)
