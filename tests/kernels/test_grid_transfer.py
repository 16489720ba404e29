"""Transfer between a grid and the one of twice its edge against the dense interpolation matrix."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
import warp as wp

from kernels.grid_transfer import coarse_stiffness, interpolate, restrict

ROUNDING = 1e-13
"""Of the largest value: sums of a few hundred products in float64."""
SINGLE = 2e-6
"""Relative tolerance in float32, for sums of 27 products."""
CORNERS = np.array(list(product((0, 1), repeat=3)))


def put(values, dtype):
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu")


def weights(fine, coarse):
    """Return trilinear interpolation weights from spacing 2 to spacing 1, shape (fine, coarse)."""
    return np.clip(1.0 - 0.5 * np.abs(fine[:, None] - 2.0 * coarse), 0.0, None).prod(axis=2)


def test_coarse_cell_is_the_galerkin_projection_of_its_children():
    """K = sum P^T M K M P over the live children there are."""
    random = np.random.default_rng(0)
    nodes = np.array(list(np.ndindex(3, 3, 3)))
    number = np.arange(27).reshape(3, 3, 3)
    cell_nodes = np.array([[number[tuple(low + corner)] for corner in CORNERS] for low in CORNERS])
    dense = random.normal(size=(8, 24, 24))
    dense = dense + dense.transpose(0, 2, 1)
    split = dense.reshape(8, 8, 3, 8, 3).transpose(0, 1, 3, 2, 4)
    packed = np.stack(
        [split[:, a, b] for a, b in combinations_with_replacement(range(8), 2)], axis=1
    )
    live, there = np.array([1, 1, 0, 1, 0, 1, 1, 1]), np.array([1, 1, 1, 1, 1, 1, 0, 1])
    free = (random.uniform(size=(27, 3)) > 0.3).astype(float)
    children = np.where(there, np.arange(8), -1)[None]
    out = wp.full((1, 36), wp.mat33d(1.0), dtype=wp.mat33d, device="cpu")
    alive = wp.zeros(1, dtype=wp.uint8, device="cpu")
    inputs = [
        put(cell_nodes, wp.int32),
        put(live, wp.uint8),
        put(packed, wp.mat33d),
        put(free, wp.vec3d),
        put(children, wp.int32),
        put([0], wp.int32),
        0,
    ]
    wp.launch(coarse_stiffness, dim=1, inputs=inputs, outputs=[out, alive], device="cpu")
    fine = np.zeros((81, 81))
    for cell in np.flatnonzero(there):
        unknowns = (3 * cell_nodes[cell][:, None] + np.arange(3)).ravel()
        mask = free[cell_nodes[cell]].ravel()
        fine[np.ix_(unknowns, unknowns)] += live[cell] * mask[:, None] * dense[cell] * mask
    parent = np.kron(weights(nodes, CORNERS), np.eye(3))
    right = (parent.T @ fine @ parent).reshape(8, 3, 8, 3).transpose(0, 2, 1, 3)
    right = np.stack([right[a, b] for a, b in combinations_with_replacement(range(8), 2)])
    assert alive.numpy()[0] == 1
    assert out.numpy()[0] == pytest.approx(right, abs=ROUNDING * np.abs(right).max())


def test_residuals_go_up_and_corrections_down_by_the_interpolation():
    random = np.random.default_rng(1)
    fine, coarse = (np.array(list(np.ndindex(n, n, n))) for n in (5, 3))
    matrix = weights(fine, coarse)
    free = (random.uniform(size=(125, 3)) > 0.3).astype(np.float32)
    residual, vector = random.normal(size=(2, 125, 3)).astype(np.float32)
    correction = random.normal(size=(27, 3)).astype(np.float32)
    number = np.pad(np.arange(125).reshape(5, 5, 5), 1, constant_values=-1)
    fine_of = np.stack(
        [number[tuple((2 * coarse + 1 + step).T)] for step in product((-1, 0, 1), repeat=3)], axis=1
    )
    coarse_of = np.full((125, 8), -1)
    for node, row in enumerate(matrix):
        near = np.flatnonzero(row)
        coarse_of[node, : len(near)] = near
    load = wp.zeros(27, dtype=wp.vec3f, device="cpu")
    inputs = [put(fine_of, wp.int32), put(free, wp.vec3f), put(residual, wp.vec3f), 0]
    wp.launch(restrict, dim=27, inputs=inputs, outputs=[load], device="cpu")
    assert load.numpy() == pytest.approx(matrix.T @ (free * residual), abs=SINGLE * 8.0)
    out = put(vector, wp.vec3f)
    inputs = [put(coarse_of, wp.int32), put(matrix.max(axis=1), wp.float32), put(free, wp.vec3f)]
    wp.launch(
        interpolate,
        dim=125,
        inputs=[*inputs, put(correction, wp.vec3f), 0],
        outputs=[out],
        device="cpu",
    )
    assert out.numpy() == pytest.approx(vector + free * (matrix @ correction), abs=SINGLE * 8.0)
