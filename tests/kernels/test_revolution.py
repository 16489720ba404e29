"""Tabulated body of revolution, against bilinear interpolation in SciPy and an exact ball."""

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from kernels.revolution import Revolution, nearest_on, offset_from

SINGLE = 2e-5
"""[voxel]: places of up to 20 voxels in float32, and a table that changes by 1 a voxel."""
RADIUS, CELLS_PER_VOXEL, LOWEST = 8.0, 2.0, -3.0


@wp.kernel
def evaluate(
    tool: Revolution,
    offset: wp.array(dtype=wp.vec3),
    axis: wp.vec3,
    value_out: wp.array2d(dtype=float),
    slope_out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    found = nearest_on(tool, offset[i], axis)
    value_out[i, 0] = found.distance
    value_out[i, 1] = found.bend
    slope_out[i] = found.slope


@wp.kernel
def subtract(
    pose: wp.array(dtype=wp.vec3d),
    voxel: wp.array(dtype=wp.vec3i),
    offset_out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    offset_out[i] = offset_from(pose[1], voxel[i])


def test_distance_and_slope_of_a_ball_by_its_table():
    """Distance and slope of a ball by its table agree with SciPy's interpolation.

    The slope equals the ball's up to the table's second differences.
    """
    random = np.random.default_rng(0)
    radius, height = np.arange(40) / CELLS_PER_VOXEL, LOWEST + np.arange(50) / CELLS_PER_VOXEL
    table = np.hypot(radius[:, None], height - RADIUS) - RADIUS
    bend = random.uniform(size=table.shape)
    slopes = np.stack(np.gradient(table, 1.0 / CELLS_PER_VOXEL), axis=-1)
    tool = Revolution()
    tool.distance = wp.array(table, dtype=wp.float32, device="cpu")
    tool.slope = wp.array(slopes, dtype=wp.vec2, device="cpu")
    tool.bend = wp.array(bend, dtype=wp.float32, device="cpu")
    tool.height_min, tool.cells_per_voxel = LOWEST, CELLS_PER_VOXEL
    turn = Rotation.random(random_state=2).as_matrix()
    local = random.uniform([-12.0, -12.0, LOWEST + 0.1], [12.0, 12.0, 20.0], (500, 3))
    offset = wp.array(local @ turn.T, dtype=wp.vec3, device="cpu")
    value, slope = (
        wp.zeros((500, 2), dtype=float, device="cpu"),
        wp.zeros(500, dtype=wp.vec3, device="cpu"),
    )
    wp.launch(
        evaluate,
        dim=500,
        inputs=[tool, offset, wp.vec3(*turn[:, 2])],
        outputs=[value, slope],
        device="cpu",
    )
    at = np.stack([np.linalg.norm(local[:, :2], axis=1), local[:, 2] - LOWEST]) * CELLS_PER_VOXEL
    assert value.numpy()[:, 0] == pytest.approx(map_coordinates(table, at, order=1), abs=SINGLE)
    outward, upward = (map_coordinates(slopes[..., c], at, order=1) for c in range(2))
    section = np.column_stack(
        [outward[:, None] * local[:, :2] / np.linalg.norm(local[:, :2], axis=1)[:, None], upward]
    )
    assert slope.numpy() @ turn == pytest.approx(section, abs=SINGLE)
    edge = (np.abs(at - np.round(at)) < 1e-4).any(axis=0)  # float32 may find the next cell
    cell = at.astype(int)
    assert value.numpy()[~edge, 1] == pytest.approx(bend[cell[0], cell[1]][~edge], abs=1e-6)
    arm = local - [0.0, 0.0, RADIUS]
    far = np.linalg.norm(arm, axis=1) > 3.0
    right = arm / np.linalg.norm(arm, axis=1)[:, None]
    # a cell of the table, over the distance's curvature
    bound = 0.5 / CELLS_PER_VOXEL / np.linalg.norm(arm, axis=1)
    assert (np.linalg.norm(slope.numpy() @ turn - right, axis=1)[far] < bound[far]).all()


def test_offsets_are_taken_in_double_precision():
    random = np.random.default_rng(1)
    poses, voxel = random.uniform(900.0, 1000.0, (3, 6)), random.integers(900, 1000, (200, 3))
    out = wp.zeros(200, dtype=wp.vec3, device="cpu")
    inputs = [
        wp.array(poses[:, :3].copy(), dtype=wp.vec3d, device="cpu"),
        wp.array(voxel, dtype=wp.vec3i, device="cpu"),
    ]
    wp.launch(subtract, dim=200, inputs=inputs, outputs=[out], device="cpu")
    np.testing.assert_array_equal(out.numpy(), (voxel - poses[1, :3]).astype(np.float32))
