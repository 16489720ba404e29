"""Distance from a tool of revolution and its bounds over triangles.

The distance is compared with closed forms in NumPy, the bounds with samples.
"""

import numpy as np
import pytest
import warp as wp

from kernels.tool_distance import Outline, bounds_over, distance_to_part, nearest_on_triangle

RADIUS, HEIGHT = 1.5, 4.0


@wp.kernel
def distances(
    outline: Outline, points: wp.array(dtype=wp.vec3d), distance_out: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    least = wp.float64(1.0e9)
    for part in range(outline.convex.shape[0]):
        value, _gradient, _bend = distance_to_part(outline, part, points[i])
        least = wp.min(least, value)
    distance_out[i] = least


@wp.kernel
def bounds(
    outline: Outline,
    corners: wp.array2d(dtype=wp.vec3d),
    lower_out: wp.array(dtype=wp.float64),
    upper_out: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    lower, upper = bounds_over(
        outline, corners[i, 0], corners[i, 1], corners[i, 2], wp.float64(1.0e9)
    )
    lower_out[i] = lower
    upper_out[i] = upper


@wp.kernel
def feet(
    points: wp.array(dtype=wp.vec3d),
    corners: wp.array2d(dtype=wp.vec3d),
    foot_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    foot_out[i] = nearest_on_triangle(points[i], corners[i, 0], corners[i, 1], corners[i, 2])


def cylinder():
    """Return the half section of a cylinder from z = 0 to `HEIGHT`.

    It has bottom, side and top, each with start, direction and length.
    """
    rows = np.zeros((3, 10))
    rows[:, :5] = [[0, 0, 1, 0, RADIUS], [RADIUS, 0, 0, 1, HEIGHT], [RADIUS, HEIGHT, -1, 0, RADIUS]]
    outline = Outline()
    outline.kind = wp.array([0, 0, 0], dtype=wp.int32, device="cpu")
    outline.shape = wp.array(rows, dtype=wp.float64, device="cpu")
    outline.first = wp.array([0, 3], dtype=wp.int32, device="cpu")
    outline.convex = wp.array([1], dtype=wp.int32, device="cpu")
    return outline


def from_cylinder(points):
    """Signed distance from that cylinder."""
    across = np.linalg.norm(points[..., :2], axis=-1) - RADIUS
    along = np.maximum(-points[..., 2], points[..., 2] - HEIGHT)
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return outside + np.minimum(np.maximum(across, along), 0.0)


def vectors(values):
    return wp.array(np.ascontiguousarray(values), dtype=wp.vec3d, device="cpu")


@pytest.mark.parametrize("seed", range(3))
def test_the_distance_is_that_of_a_cylinder(seed):
    points = np.random.default_rng(seed).uniform([-4, -4, -3], [4, 4, 7], (500, 3))
    found = wp.zeros(500, dtype=wp.float64, device="cpu")
    wp.launch(
        distances, dim=500, inputs=[cylinder(), vectors(points)], outputs=[found], device="cpu"
    )
    np.testing.assert_allclose(found.numpy(), from_cylinder(points), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_bounds_over_a_triangle_hold_its_smallest_distance(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform([-4, -4, -3], [4, 4, 7], (100, 3, 3))
    lower, upper = (wp.zeros(100, dtype=wp.float64, device="cpu") for _ in range(2))
    inputs = [cylinder(), wp.array(corners, dtype=wp.vec3d, device="cpu")]
    wp.launch(bounds, dim=100, inputs=inputs, outputs=[lower, upper], device="cpu")
    weights = rng.dirichlet([1.0, 1.0, 1.0], 4000)
    sampled = from_cylinder(np.einsum("sw,twx->tsx", weights, corners)).min(axis=1)
    assert (lower.numpy() <= sampled + 1e-12).all()
    assert (upper.numpy() >= lower.numpy() - 1e-12).all()
    # The upper bound is the distance of some point of the triangle; samples miss the smallest one
    # by a little.
    assert (upper.numpy() >= sampled - 0.3).all()
    assert np.median(upper.numpy() - lower.numpy()) < 0.1


def test_the_nearest_point_of_a_triangle_is_no_farther_than_any_other():
    rng = np.random.default_rng(5)
    points, corners = rng.normal(size=(200, 3)), rng.normal(size=(200, 3, 3))
    found = wp.zeros(200, dtype=wp.vec3d, device="cpu")
    inputs = [vectors(points), wp.array(corners, dtype=wp.vec3d, device="cpu")]
    wp.launch(feet, dim=200, inputs=inputs, outputs=[found], device="cpu")
    weights = rng.dirichlet([0.5, 0.5, 0.5], 4000)
    sampled = np.linalg.norm(
        np.einsum("sw,twx->tsx", weights, corners) - points[:, None], axis=2
    ).min(axis=1)
    nearest = np.linalg.norm(found.numpy() - points, axis=1)
    assert (nearest <= sampled + 1e-12).all() and (nearest >= sampled - 0.1).all()
    mixed = np.linalg.solve(np.moveaxis(corners, 1, 2), found.numpy()[..., None])[..., 0]
    np.testing.assert_allclose(mixed.sum(axis=1), 1.0, atol=1e-6)
    assert (mixed > -1e-6).all()
