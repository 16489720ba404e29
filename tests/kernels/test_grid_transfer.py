"""Transfer between a grid and the one of twice its edge against the dense interpolation matrix."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
import warp as wp

from kernels.grid_transfer import (
    assemble_rows,
    coarse_stiffness,
    first_residuals,
    interpolate,
    restrict,
    sweep_colour,
)

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


SWEEP_SINGLE = 1e-5
"""Of the largest value: sums of 27 blocks in float32, and inverses of condition up to ten."""


CELLS = 2


class Grid:
    """A cube of cells of random positive stiffness, a few of them empty, some components held."""

    def __init__(self, seed=0):
        random = np.random.default_rng(seed)
        nodes = np.array(list(np.ndindex((CELLS + 1,) * 3)))
        number = np.pad(np.arange(len(nodes)).reshape((CELLS + 1,) * 3), 1, constant_values=-1)
        lows = np.array(list(np.ndindex((CELLS,) * 3)))
        self.cell_nodes = np.stack(
            [number[tuple((lows + corner + 1).T)] for corner in CORNERS], axis=1
        )
        self.node_cells = np.full((len(nodes), 8), -1)
        for cell, corner in np.ndindex(self.cell_nodes.shape):
            self.node_cells[self.cell_nodes[cell, corner], corner] = cell
        self.live = random.uniform(size=len(lows)) > 0.25
        half = random.normal(size=(len(lows), 24, 24)) + 8.0 * np.eye(24)
        self.cells = half @ half.transpose(0, 2, 1)
        self.free = (random.uniform(size=nodes.shape) > 0.2).astype(float)
        self.load = random.normal(size=nodes.shape)
        self.colour = (nodes % 2) @ (4, 2, 1)
        around = np.stack(
            [number[tuple((nodes + 1 + step).T)] for step in product((-1, 0, 1), repeat=3)], axis=1
        )
        self.start, self.column, self.place = [0], [], np.full((len(nodes), 27), -1)
        for node, neighbours in enumerate(around):
            there = np.flatnonzero(neighbours >= 0)
            there = there[np.argsort(self.colour[neighbours[there]], kind="stable")]
            self.place[node, there] = len(self.column) + np.arange(len(there))
            self.column.extend(neighbours[there])
            self.start.append(len(self.column))

    def matrix(self):
        """Sum of M K M over the live cells, M the mask of what may move."""
        whole = np.zeros((self.free.size, self.free.size))
        for cell in np.flatnonzero(self.live):
            unknowns = (3 * self.cell_nodes[cell][:, None] + np.arange(3)).ravel()
            whole[np.ix_(unknowns, unknowns)] += self.cells[cell]
        mask = self.free.ravel()
        return mask[:, None] * whole * mask

    def carries(self):
        """Components with any stiffness, or held, which counts as one of 1; shape (nodes, 3)."""
        return self.matrix().diagonal().reshape(-1, 3) + 1.0 - self.free > 0.0

    def rows(self):
        """Kernel's blocks, rounded blocks and inverses, as Warp arrays."""
        split = self.cells.reshape(-1, 8, 3, 8, 3).transpose(0, 1, 3, 2, 4)
        packed = np.stack(
            [split[:, a, b] for a, b in combinations_with_replacement(range(8), 2)], axis=1
        )
        count = len(self.free)
        # in any order
        rows, start = put(np.arange(count)[::-1], wp.int32), put(self.start, wp.int32)
        made = [
            put(np.full((len(self.column), 3, 3), 7.0), wp.mat33d),  # of an earlier assembly
            wp.zeros(len(self.column), dtype=wp.mat33f, device="cpu"),
            wp.zeros(count, dtype=wp.mat33f, device="cpu"),
        ]
        inputs = [
            rows,
            start,
            put(self.node_cells, wp.int32),
            put(self.place, wp.int32),
            put(self.free, wp.vec3d),
            put(self.cell_nodes, wp.int32),
            put(self.live, wp.uint8),
            put(packed, wp.mat33d),
            0,
        ]
        wp.launch(assemble_rows, dim=count, inputs=inputs, outputs=made, device="cpu")
        return made


def dense(grid, block):
    whole = np.zeros((len(grid.free), 3, len(grid.free), 3))
    for node in range(len(grid.free)):
        for place in range(grid.start[node], grid.start[node + 1]):
            whole[node, :, grid.column[place]] = block[place]
    return whole.reshape(grid.free.size, grid.free.size)


@pytest.mark.parametrize("seed", range(3))
def test_rows_are_those_of_the_assembled_matrix(seed):
    grid = Grid(seed)
    block, single, inverse = grid.rows()
    right = grid.matrix()
    assert dense(grid, block.numpy()) == pytest.approx(right, abs=ROUNDING * np.abs(right).max())
    np.testing.assert_array_equal(single.numpy(), block.numpy().astype(np.float32))
    count = len(grid.free)
    middle = right.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    middle = middle + (1.0 - grid.free)[:, :, None] * np.eye(3)
    unit = grid.carries()[:, :, None] * np.eye(3)
    assert inverse.numpy() @ middle == pytest.approx(unit, abs=SWEEP_SINGLE)


def test_sweeps_are_gauss_seidel_by_colours():
    """Sweeps are Gauss-Seidel by colours.

    The first sweep solves (L + D) v = f and leaves f - K v; a second corrects v by (L + D)^-1 of
    that.
    """
    grid = Grid()
    _, single, inverse = grid.rows()
    count, matrix = len(grid.free), grid.matrix()
    start, column = put(grid.start, wp.int32), put(grid.column, wp.int32)
    load = grid.load * grid.free * grid.carries()
    given = put(load, wp.vec3f)
    vector = wp.zeros(count, dtype=wp.vec3f, device="cpu")
    left = wp.zeros(count, dtype=wp.vec3f, device="cpu")
    colours = [put(np.flatnonzero(grid.colour == each), wp.int32) for each in range(8)]
    for nodes in colours:
        inputs = [nodes, start, column, single, inverse, given, 0]
        wp.launch(sweep_colour, dim=len(nodes), inputs=inputs, outputs=[vector], device="cpu")
    middle = put(grid.place[:, 13], wp.int32)
    inputs = [start, middle, column, single, vector, 0]
    wp.launch(first_residuals, dim=count, inputs=inputs, outputs=[left], device="cpu")
    rank = np.repeat(grid.colour, 3)
    on_diagonal = np.kron(np.eye(count), np.ones((3, 3))) > 0.0
    lower = np.where((rank[:, None] > rank) | on_diagonal, matrix, 0.0) + np.diag(
        1.0 - (grid.free * grid.carries()).ravel()
    )
    right = np.linalg.solve(lower, load.ravel())
    remainder = load.ravel() - matrix @ right
    assert vector.numpy().ravel() == pytest.approx(right, abs=SWEEP_SINGLE * np.abs(right).max())
    assert left.numpy().ravel() == pytest.approx(
        remainder, abs=SWEEP_SINGLE * np.abs(remainder).max()
    )
    for nodes in colours:
        inputs = [nodes, start, column, single, inverse, given, 0]
        wp.launch(sweep_colour, dim=len(nodes), inputs=inputs, outputs=[vector], device="cpu")
    again = right + np.linalg.solve(lower, remainder)
    assert vector.numpy().ravel() == pytest.approx(again, abs=SWEEP_SINGLE * np.abs(again).max())
    assert np.linalg.norm(again - right) > 0.01 * np.linalg.norm(right)
