"""Strips of cells against dense matrices: layout, weights and product."""

import numpy as np
import pytest
import warp as wp
from tooth_bodies import at_bottom, block, dense_stiffness, lattice, ragged_block

from kernels.cell_strips import LANES
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import ParticleSet
from tissue.models.tooth.strips import LaneVector, StripLayout, StripProduct

DOUBLE, SINGLE = 1e-13, 2e-6
"""Of the largest value: sums of some hundred products in float64 and float32."""


def body_of(particles, grid):
    return ParticleBody(particles, grid, at_bottom(grid))


def test_slots_are_apart_and_strips_hold_every_cell_once():
    _, grid = ragged_block()
    layout = StripLayout(grid)
    assert (
        len(np.unique(layout.slot)) == grid.node_count and layout.slot.max() + LANES < layout.slots
    )
    assert len(np.unique(layout.strip, axis=0)) == grid.cell_count
    strip, lane = layout.strip.T
    for corner, (pencil, above) in enumerate(np.ndindex(4, 2)):
        assert np.array_equal(
            layout.slot[grid.cell_nodes[:, corner]], layout.base[strip, pencil] + lane + above
        )


@pytest.mark.parametrize("scalar, tolerance", [(wp.float64, DOUBLE), (wp.float32, SINGLE)])
def test_product_is_that_of_the_cells_matrices_on_any_number_of_cores(scalar, tolerance):
    body = body_of(*ragged_block())
    strips, count = body.cells, body.grid.node_count
    assert strips.regular.all()
    vector = np.random.default_rng(1).normal(size=(count, 3))
    found = []
    for cores in (1, 3):
        moved, force = (LaneVector(strips.layout, scalar, device="cpu") for _ in range(2))
        moved.single.numpy()[:, strips.layout.slot] = vector.T
        weight = strips.weight if scalar is wp.float64 else strips.single
        StripProduct(strips.layout, weight, moved, force, device="cpu", cores=cores)()
        found.append(force.single.numpy()[:, strips.layout.slot].T)
    wanted = (dense_stiffness(body) @ vector.ravel()).reshape(-1, 3)
    assert np.abs(found[0] - wanted).max() <= tolerance * np.abs(wanted).max()
    assert np.array_equal(found[0], found[1])


def test_cells_of_other_particles_are_left_to_their_matrices():
    """Cells with other numbers of particles keep their own matrices.

    A third of the cells has 27 particles; cut cells and cells that carry nothing are counted in
    both.
    """
    particles, grid = block(
        (4, 3, 11), 1e-3, places=lattice(3), modulus_Pa=lambda x: 1e10 * (1.0 + x[:, 0] / 1e-3)
    )
    coarse = ParticleSet(
        *(getattr(particles, name).copy() for name in particles.__dataclass_fields__)
    )
    cell = grid.locate(coarse.position_m)[0]
    place = grid.locate(coarse.position_m)[1]
    moved = (cell % 3 > 0)[:, None]
    coarse.position_m[:] = np.where(
        moved,
        coarse.position_m + 1e-3 * (np.where(place < 0.5, 0.25, 0.75) - place),
        coarse.position_m,
    )
    body = body_of(coarse, grid)
    assert 0.5 < body.cells.regular.mean() < 0.8
    body.set_remaining(np.arange(0, len(cell), 5), np.full(len(cell[::5]), 9000))
    body.update()
    live = np.arange(grid.cell_count) % 7 != 3
    body.cells.set_live(live)
    vector = np.random.default_rng(1).normal(size=(grid.node_count, 3))
    wanted = (dense_stiffness(body) @ vector.ravel()).reshape(-1, 3)
    assert np.abs(body.cells.product(vector) - wanted).max() <= DOUBLE * np.abs(wanted).max()
