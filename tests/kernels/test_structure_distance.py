"""Distance between tools and a box, against its closed form."""

import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation
from structure_poses import distance_m

from kernels.elements import CHUNK, Elements
from kernels.structure_distance import clearance
from tissue.cutters import profile
from tissue.models.keep_clear import KeepClear, Structure

SIDES_M = np.array([8e-3, 6e-3, 4e-3])
BALL_M = 1.5e-3


def from_box(points_m):
    """Signed distance from a box about the origin."""
    out = np.abs(points_m) - 0.5 * SIDES_M
    return np.linalg.norm(np.maximum(out, 0.0), axis=-1) + np.minimum(out.max(axis=-1), 0.0)


@pytest.mark.parametrize("seed", range(2))
def test_a_ball_is_as_far_as_its_centre_less_its_radius(seed):
    """Outside, across the surface and with the centre inside the box."""
    box = trimesh.creation.box(1e3 * SIDES_M)
    structure = Structure(1e-3 * np.asarray(box.vertices), np.asarray(box.faces))
    clear = KeepClear(profile.ball_burr(diameter_m=2 * BALL_M), {"box": structure})
    rng = np.random.default_rng(seed)
    # Above the box, so that the shank, which points away from it, is never nearer than the ball.
    for centre in rng.uniform([-6e-3, -5e-3, 0.5e-3], [6e-3, 5e-3, 6e-3], (30, 3)):
        turn = Rotation.from_euler("xy", rng.uniform(-10, 10, 2), degrees=True)
        found = distance_m(clear, centre - turn.apply([0.0, 0.0, BALL_M]), turn)
        exact = from_box(centre) - BALL_M
        assert exact - 1e-5 <= found <= exact + 1e-9


SPACING_M = 1e-4


ROUNDING_M = 4e-8
"""Rounding error of distances [m].

Places of up to 40 voxels are known to 1e-5 voxel in float32, and the field changes by up to 2 mm a
voxel.
"""


def test_least_distance_of_each_chunk_also_outside_the_grid():
    random = np.random.default_rng(0)
    field = random.uniform(-1e-3, 1e-3, (20, 24, 28)).astype(np.float32)
    points = random.uniform(-1e-3, 1e-3, (2 * CHUNK + 40, 3)).astype(np.float32)
    turn, tip = Rotation.random(random_state=1).as_matrix(), np.array([6.0, 11.0, 15.0])
    elements = Elements()
    elements.point = wp.array(points, dtype=wp.vec3, device="cpu")
    motion = wp.array(np.vstack([tip, turn.T]), dtype=wp.vec3d, device="cpu")
    out = wp.zeros(3, dtype=wp.float32, device="cpu")
    inputs = [elements, motion, SPACING_M, wp.array(field, dtype=wp.float32, device="cpu"), 0]
    wp.launch(clearance, dim=3, inputs=inputs, outputs=[out], device="cpu")
    at = tip + points.astype(float) @ turn.T / SPACING_M
    each = map_coordinates(field.astype(float), at.T - 0.5, order=1, mode="nearest")
    outside = (at < 0.0).any(axis=1)
    assert outside.sum() > 20
    right = [each[start : start + CHUNK].min() for start in range(0, len(each), CHUNK)]
    np.testing.assert_allclose(out.numpy(), right, rtol=0.0, atol=ROUNDING_M)
