"""Smallest distance of a tool's elements from a field, against SciPy's linear interpolation."""

import numpy as np
import warp as wp
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from kernels.clearance import clearance
from kernels.elements import CHUNK, Elements

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
    motion = wp.array(np.vstack([tip, turn.T]), dtype=wp.float64, device="cpu")
    out = wp.zeros(3, dtype=wp.float32, device="cpu")
    inputs = [elements, motion, SPACING_M, 0, wp.array(field, dtype=wp.float32, device="cpu")]
    wp.launch(clearance, dim=3, inputs=inputs, outputs=[out], device="cpu")
    at = tip + points.astype(float) @ turn.T / SPACING_M
    each = map_coordinates(field.astype(float), at.T - 0.5, order=1, mode="nearest")
    outside = (at < 0.0).any(axis=1)
    assert outside.sum() > 20
    right = [each[start : start + CHUNK].min() for start in range(0, len(each), CHUNK)]
    np.testing.assert_allclose(out.numpy(), right, rtol=0.0, atol=ROUNDING_M)
