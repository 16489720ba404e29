"""Readings of poses, compliance blocks and shell planes against NumPy."""

import numpy as np
import pytest
import warp as wp

from kernels.contact_state import Body, Points, block, distance_to, pose_of
from kernels.probe_distance import SHELL

ROUNDING = 1e-14
"""Sums of three products of numbers of size one."""
NODES = 4


@wp.kernel
def read(
    body: Body,
    points: Points,
    rows: wp.array2d(dtype=wp.float64),
    place: wp.array(dtype=wp.vec3d),
    block_out: wp.array2d(dtype=wp.mat33d),
    moved_out: wp.array2d(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
    direction_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    pose = pose_of(rows)
    moved_out[i, 0] = pose.tip + pose.turn * place[i]
    moved_out[i, 1] = pose.last_tip + pose.last_turn * place[i]
    for j in range(place.shape[0]):
        block_out[i, j] = block(body, i, j)
    distance, direction = distance_to(SHELL, wp.vec2d(), pose, points, i, place[i])
    distance_out[i] = distance
    direction_out[i] = direction


def test_readings():
    """Rows are tip, rotation, last tip and last rotation.

    A shell's point stands for the plane through it.
    """
    random = np.random.default_rng(0)
    compliance, rows = random.normal(size=(3 * NODES, 3 * NODES)), random.normal(size=(8, 3))
    place, at, normal = random.normal(size=(3, NODES, 3))
    body, points = Body(), Points()
    body.scale = wp.float64(0.4)
    body.compliance = wp.array(compliance, dtype=wp.float64, device="cpu")
    points.tool_point = wp.array(at, dtype=wp.vec3d, device="cpu")
    points.tool_normal = wp.array(normal, dtype=wp.vec3d, device="cpu")
    out = [
        wp.zeros((NODES, NODES), dtype=wp.mat33d, device="cpu"),
        wp.zeros((NODES, 2), dtype=wp.vec3d, device="cpu"),
        wp.zeros(NODES, dtype=wp.float64, device="cpu"),
        wp.zeros(NODES, dtype=wp.vec3d, device="cpu"),
    ]
    inputs = [
        body,
        points,
        wp.array(rows, dtype=wp.float64, device="cpu"),
        wp.array(place, dtype=wp.vec3d, device="cpu"),
    ]
    wp.launch(read, dim=NODES, inputs=inputs, outputs=out, device="cpu")
    blocks, moved, distance, direction = (each.numpy() for each in out)
    assert blocks == pytest.approx(
        0.4 * compliance.reshape(NODES, 3, NODES, 3).transpose(0, 2, 1, 3), abs=ROUNDING
    )
    assert moved[:, 0] == pytest.approx(rows[0] + place @ rows[1:4].T, abs=ROUNDING)
    assert moved[:, 1] == pytest.approx(rows[4] + place @ rows[5:8].T, abs=ROUNDING)
    assert distance == pytest.approx(((place - at) * normal).sum(axis=1), abs=ROUNDING)
    np.testing.assert_array_equal(direction, normal)
