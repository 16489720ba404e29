"""Vectors in lanes against NumPy.

The tests cover the diagonal, the assumed eigenvalue, a smoothing step, and the conversion from
nodes and back.
"""

import numpy as np
import pytest
import warp as wp
from tooth_bodies import at_bottom, block, dense_stiffness, lattice, ragged_block

from kernels.lane_vectors import from_lanes, smooth, to_lanes
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.strips import LaneVector, StripLayout


def body_of(particles, grid):
    return ParticleBody(particles, grid, at_bottom(grid))


def test_diagonal_and_its_inverse_follow_removal():
    body = body_of(*ragged_block())
    body.set_remaining(np.arange(0, 300), np.zeros(300, dtype=int))
    body.update()
    finest, free = body._hierarchy.finest, ~body.supports.fixed
    exact = np.diag(dense_stiffness(body)).reshape(-1, 3)
    assert finest.diagonal.numpy() == pytest.approx(np.where(free, exact, 1.0), rel=1e-12)
    inverse = finest._inverse.single.numpy()[:, body.cells.layout.slot].T
    there = free & (exact > 0.0)
    assert not inverse[~there].any()
    ratio = inverse[there] * exact[there]
    assert ratio == pytest.approx(ratio[0], rel=1e-6)


def test_assumed_eigenvalue_is_above_the_largest():
    body = body_of(*ragged_block())
    body._hierarchy.refresh()
    layout = body.cells.layout
    inverse = body._hierarchy.finest._inverse.single.numpy()[:, layout.slot].T.ravel()
    root = np.sqrt(inverse)
    values = np.linalg.eigvalsh(root[:, None] * dense_stiffness(body) * root)
    assert 0.75 < values[-1] <= 1.0


def test_smoothing_multiplies_by_every_cell_wherever_its_particles_lie():
    """Smoothing multiplies by every cell wherever its particles lie.

    The particles of every third cell lie off the strips' points, so that an omitted or moved
    particle would show.
    """
    aside = np.arange(4 * 3 * 11) % 3 == 0
    body = body_of(*block((4, 3, 11), 1e-3, places=lattice(2) + 0.2 * aside[:, None, None]))
    assert np.array_equal(body.cells.regular, ~aside)
    finest, slot = body._hierarchy.finest, body.cells.layout.slot
    vector = np.random.default_rng(2).normal(size=(body.grid.node_count, 3)).astype(np.float32)
    finest._direction.single.numpy()[:, slot] = vector.T
    finest._multiply()
    wanted = (dense_stiffness(body) @ vector.ravel()).reshape(-1, 3)
    assert (
        np.abs(finest._force.single.numpy()[:, slot].T - wanted).max()
        <= 2e-6 * np.abs(wanted).max()
    )


def test_lanes_give_back_what_they_take_and_a_step_is_its_formula():
    _, grid = ragged_block()
    layout, random = StripLayout(grid), np.random.default_rng(0)
    slot = wp.array(layout.slot, dtype=wp.int32, device="cpu")
    names = ("inverse", "force", "residual", "direction", "vector")
    lanes = {name: LaneVector(layout, wp.float32, device="cpu") for name in names}
    given = {name: random.normal(size=(grid.node_count, 3)).astype(np.float32) for name in names}
    for name in names:
        source = wp.array(given[name], dtype=wp.vec3f, device="cpu")
        wp.launch(
            to_lanes,
            dim=len(slot),
            inputs=[slot, source, 0],
            outputs=[lanes[name].single],
            device="cpu",
        )
    inputs = [lanes["inverse"].by_eight, 0.2, 2.4, 0]
    outputs = [lanes[name].by_eight for name in names[1:]]
    wp.launch(smooth, dim=outputs[0].shape[1], inputs=inputs, outputs=outputs, device="cpu")
    left = given["residual"] - given["force"]
    wanted = {
        "force": 0.0 * left,
        "residual": left,
        "direction": 0.2 * given["direction"] + 2.4 * given["inverse"] * left,
        "vector": given["vector"] + given["direction"],
    }
    for name, right in wanted.items():
        found = wp.zeros(len(slot), dtype=wp.vec3f, device="cpu")
        wp.launch(
            from_lanes,
            dim=len(slot),
            inputs=[slot, lanes[name].single, 0],
            outputs=[found],
            device="cpu",
        )
        assert found.numpy() == pytest.approx(right, abs=1e-5)
