"""Turns on the group and path lengths against SciPy's rotations."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.rigid_motion import motion_length, pose_distance, turn_between, turned_by

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
