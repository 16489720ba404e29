"""Distances to a tool against NumPy, and their gradients against differences."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.contact_state import pose_of
from kernels.probe_distance import axis_distance
from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe


@wp.kernel
def distance_each(
    kind: int,
    size: wp.vec2d,
    rows: wp.array2d(dtype=wp.float64),
    point: wp.array(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
    direction_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    distance, direction = axis_distance(kind, size, pose_of(rows), point[i])
    distance_out[i] = distance
    direction_out[i] = direction


@pytest.mark.parametrize(
    "probe", [SphereProbe(0.004), CylinderProbe(0.004, 0.0005)], ids=["sphere", "cylinder"]
)
def test_distances_agree_with_numpy_and_their_gradients_with_differences(probe):
    rng = np.random.default_rng(3)
    rotation, tip = Rotation.random(random_state=1).as_matrix(), np.array([0.01, -0.02, 0.03])
    local = rng.uniform([-0.006, -0.006, -0.003], [0.006, 0.006, 0.009], (3000, 3))
    rows = np.vstack([tip, rotation, tip, rotation])

    def kernel(points):
        out = (
            wp.zeros(len(points), dtype=wp.float64, device="cpu"),
            wp.zeros(len(points), dtype=wp.vec3d, device="cpu"),
        )
        inputs = [
            probe.kind,
            wp.vec2d(*probe.size_m),
            wp.array(rows, dtype=wp.float64, device="cpu"),
            wp.array(tip + points @ rotation.T, dtype=wp.vec3d, device="cpu"),
        ]
        wp.launch(distance_each, dim=len(points), inputs=inputs, outputs=list(out), device="cpu")
        return out[0].numpy(), out[1].numpy() @ rotation

    distance, direction = kernel(local)
    np.testing.assert_allclose(distance, probe.distance(local), atol=1e-15)
    step = 1e-7
    slopes = np.column_stack(
        [(kernel(local + e)[0] - kernel(local - e)[0]) / (2 * step) for e in step * np.eye(3)]
    )
    # Within a step of an edge between face and side the difference straddles both.
    smooth = np.abs(np.linalg.norm(slopes, axis=1) - 1.0) < 1e-3
    assert smooth.mean() > 0.99
    np.testing.assert_allclose(direction[smooth], slopes[smooth], atol=2e-3)


def test_the_ball_around_a_shell_lies_halfway_between_its_ends():
    """Rings of 3 mm radius at heights of 1 mm and 9 mm: a ball of 5 mm around (0, 0, 5) mm."""
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = 3e-3 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(16)])
    points = np.vstack([ring, ring]) + np.repeat([[0.0, 0.0, 1e-3], [0.0, 0.0, 9e-3]], 16, axis=0)
    shell = ShellProbe(points, np.vstack([ring, ring]) / 3e-3, np.full(32, 1e-6))
    assert shell.size_m == pytest.approx((5e-3, 5e-3))
