"""Packed cell stiffness, its product and shape function gradients, against dense NumPy matrices."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
import warp as wp

from kernels.hexahedra import (
    BLOCKS,
    CornerGradients,
    block_of,
    cell_block,
    cell_products,
    corner_gradients,
    gather_cells,
)

wp.set_module_options({"max_unroll": 1})

ROUNDING = 1e-13
"""Of the largest value: sums of at most 8 x 24 products in float64."""
CORNERS = np.array(list(product((0, 1), repeat=3)))
SHAPE = (3, 2, 2)


@wp.kernel
def read_blocks(
    stiffness: wp.array2d(dtype=wp.mat33d),
    place_out: wp.array2d(dtype=int),
    block_out: wp.array3d(dtype=wp.mat33d),
):
    cell = wp.tid()
    for a in range(8):
        for b in range(8):
            block_out[cell, a, b] = cell_block(stiffness, cell, a, b)
            place_out[a, b] = block_of(wp.min(a, b), wp.max(a, b))


@wp.kernel
def evaluate_gradients(
    at: wp.array(dtype=wp.vec3d), inverse: wp.float64, out: wp.array(dtype=CornerGradients)
):
    out[wp.tid()] = corner_gradients(at[wp.tid()], inverse)


def grid():
    """Nodes of each cell's corners, and cells of each node by corner, -1 for none."""
    number = np.arange(np.prod(np.add(SHAPE, 1))).reshape(np.add(SHAPE, 1))
    cells = np.array(list(np.ndindex(SHAPE)))
    nodes = np.stack([number[tuple((cells + corner).T)] for corner in CORNERS], axis=1)
    around = np.full((number.size, 8), -1)
    for cell, corner in np.ndindex(nodes.shape):
        around[nodes[cell, corner], corner] = cell
    return nodes, around


def random_cells(count, seed=0):
    """Dense symmetric 24 x 24 matrices and their packed blocks a <= b, row after row."""
    dense = np.random.default_rng(seed).normal(size=(count, 24, 24))
    dense = dense + dense.transpose(0, 2, 1)
    split = dense.reshape(count, 8, 3, 8, 3).transpose(0, 1, 3, 2, 4)
    packed = np.stack(
        [split[:, a, b] for a, b in combinations_with_replacement(range(8), 2)], axis=1
    )
    return dense, split, np.ascontiguousarray(packed)


def put(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


def test_blocks_are_those_of_the_dense_matrix_also_below_the_diagonal():
    _, split, packed = random_cells(4)
    assert packed.shape[1] == BLOCKS
    place = wp.zeros((8, 8), dtype=int, device="cpu")
    blocks = wp.zeros((4, 8, 8), dtype=wp.mat33d, device="cpu")
    wp.launch(
        read_blocks, dim=4, inputs=[put(packed, wp.mat33d)], outputs=[place, blocks], device="cpu"
    )
    np.testing.assert_array_equal(blocks.numpy(), split)
    assert (place.numpy()[np.triu_indices(8)] == np.arange(BLOCKS)).all()


def test_product_gathered_at_nodes_is_that_of_the_assembled_matrix():
    """Of some of the cells, in rows of their own, onto a force that is there."""
    nodes, around = grid()
    chosen = np.flatnonzero(np.arange(len(nodes)) % 3 != 2)
    row = np.random.default_rng(2).permutation(len(chosen))
    dense, _, packed = random_cells(len(nodes))
    live = np.arange(len(nodes)) % 4 != 1
    displacement = np.random.default_rng(1).normal(size=(len(around), 3))
    whole = np.zeros((displacement.size, displacement.size))
    for cell, at in zip(chosen, row, strict=True):
        unknowns = (3 * nodes[cell][:, None] + np.arange(3)).ravel()
        whole[np.ix_(unknowns, unknowns)] += dense[at] * live[cell]
    corner = wp.zeros((len(chosen), 8), dtype=wp.vec3d, device="cpu")
    inputs = [
        put(chosen, wp.int32),
        put(row, wp.int32),
        put(nodes, wp.int32),
        put(live, wp.uint8),
        put(packed, wp.mat33d),
        put(displacement, wp.vec3d),
        0,
    ]
    wp.launch(cell_products, dim=len(chosen), inputs=inputs, outputs=[corner], device="cpu")
    touched, place = np.unique(nodes[chosen]), np.full(len(nodes) + 1, -1)
    place[chosen] = np.arange(len(chosen))
    before = np.random.default_rng(3).normal(size=(len(around), 3))
    force = put(before, wp.vec3d)
    inputs = [put(touched, wp.int32), put(place[around[touched]], wp.int32), corner, 0]
    wp.launch(gather_cells, dim=len(touched), inputs=inputs, outputs=[force], device="cpu")
    right = before + (whole @ displacement.ravel()).reshape(-1, 3)
    assert force.numpy() == pytest.approx(right, abs=ROUNDING * np.abs(right).max())


def test_gradients_are_those_of_the_products_of_hat_functions():
    """Gradients equal those of products of hat functions.

    N_a is the product of x or 1 - x over axes; central differences are exact in each axis of a
    trilinear function.
    """
    at, edge, half = np.random.default_rng(2).uniform(size=(50, 3)), 0.3, 0.25
    out = wp.zeros(50, dtype=CornerGradients, device="cpu")
    wp.launch(
        evaluate_gradients,
        dim=50,
        inputs=[put(at, wp.vec3d), 1.0 / edge],
        outputs=[out],
        device="cpu",
    )

    def shapes(points):
        return np.where(CORNERS, points[:, None], 1.0 - points[:, None]).prod(axis=2)

    slopes = [
        (shapes(at + half * e) - shapes(at - half * e)) / (2.0 * half * edge) for e in np.eye(3)
    ]
    assert out.numpy() == pytest.approx(np.stack(slopes, axis=2), abs=10.0 * ROUNDING)
