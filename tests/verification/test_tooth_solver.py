"""Iterations over contrast and refinement, and outcomes of a solve.

The tests also cover islands, removal and warm starts.
"""

import numpy as np
import pytest
from tooth_bodies import at_bottom, block, lattice

from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import HexGrid, ParticleSet
from tissue.models.tooth.supports import NodeSupports

EDGE = 8e-3
CONTRASTS = (1.0, 100.0, 4200.0, 42000.0)


def ball_in_block(cells, contrast):
    """Return 84 GPa around a ball of 84 GPa / contrast, on a layer of that softer modulus.

    It represents pulp and ligament at once.
    """

    def modulus(x):
        soft = (np.linalg.norm(x - EDGE / 2, axis=1) < 0.25 * EDGE) | (x[:, 2] < 0.125 * EDGE)
        return np.where(soft, 84e9 / contrast, 84e9)

    particles, grid = block((cells,) * 3, EDGE / cells, modulus_Pa=modulus, places=lattice(2))
    return ParticleBody(particles, grid, at_bottom(grid))


def push(body, at=(0.5, 0.4, 1.0)):
    return body.spread(np.array(at) * EDGE, np.array([0.3, 0.0, -1.0]))


@pytest.mark.slow
def test_iterations_follow_neither_contrast_nor_refinement():
    """Iterations follow neither contrast nor refinement.

    The solve is to 1e-6 in the energy norm, from rest; 25 is the real molar's count, no grid may
    need 8 more than the first.
    """
    counts = np.array(
        [
            [
                ball_in_block(n, c).solve(push(ball_in_block(n, c)), tolerance=1e-6).iterations
                for n in (8, 12, 16, 20)
            ]
            for c in CONTRASTS
        ]
    )
    print("\ncontrast  8^3 12^3 16^3 20^3 cells")
    for contrast, row in zip(CONTRASTS, counts, strict=True):
        print(f"{contrast:8.0f}  {row}")
    assert counts.max() <= 25
    assert (counts - counts[:, :1]).max() <= 8


def with_pieces():
    """Return a bar held at x = 0 with separate pieces.

    They are a cell that touches the bar in an edge, and two cells apart from it.
    """
    bar = [[i, 0, 0] for i in range(4)]
    cells = np.array([*bar, [4, 1, 0], [2, 3, 0], [2, 4, 0]])
    position = ((cells[:, None] + lattice(2)) * 1e-3).reshape(-1, 3)
    particles = ParticleSet.uniform(position, volume_m3=1.25e-10, modulus_Pa=18.6e9)
    grid = HexGrid.around(position, edge_m=1e-3, origin_m=np.zeros(3))
    supports = NodeSupports.of(grid.node_count, held=grid.node_place[:, 0] == 0)
    return particles, grid, supports


def test_islands_and_hinges_are_debris_and_the_rest_solves():
    body = ParticleBody(*with_pieces())
    assert np.array_equal(body.debris, np.arange(32, 56))
    load = body.spread(np.array([3.9e-3, 0.5e-3, 1e-3]), np.array([0.0, 0.0, -1.0]))
    assert body.solve(load).outcome is SolverOutcome.CONVERGED
    matrix = body.matrix().toarray()
    kept = np.flatnonzero(np.diag(matrix) > 0.0)
    values = np.linalg.eigvalsh(matrix[np.ix_(kept, kept)])
    assert values[0] > 1e-6 * values[-1]


@pytest.mark.parametrize(
    "at", [(4.5e-3, 1.9e-3, 0.5e-3), (2.5e-3, 4.9e-3, 0.3e-3)], ids=["hinge", "island"]
)
def test_plain_assembly_is_singular_and_reports_it(at):
    body = ParticleBody(*with_pieces(), drop_islands=False)
    matrix = body.matrix().toarray()
    kept = np.flatnonzero(np.diag(matrix) > 0.0)
    values = np.linalg.eigvalsh(matrix[np.ix_(kept, kept)])
    assert int((values < 1e-10 * values[-1]).sum()) == 7  # six of the island, one of the hinge
    found = body.solve(body.spread(np.array(at), np.array([0.0, 1.0, -1.0])))
    assert found.outcome in (SolverOutcome.INDEFINITE, SolverOutcome.NOT_CONVERGED)


def test_a_load_on_debris_and_a_body_without_support_are_reported():
    body = ParticleBody(*with_pieces())
    load = np.zeros((body.grid.node_count, 3))
    load[body.grid.cell_nodes[-1][-1], 2] = 1.0
    assert body.solve(load).outcome is SolverOutcome.UNSUPPORTED
    particles, grid, _ = with_pieces()
    loose = ParticleBody(particles, grid, NodeSupports.of(grid.node_count))
    assert len(loose.debris) == len(particles.layer)
    assert loose.solve(load).outcome is SolverOutcome.UNSUPPORTED


@pytest.mark.slow
def test_removed_particles_leave_the_stiffness_of_a_fresh_assembly():
    """Removed particles leave the stiffness of a fresh assembly.

    After 1,000 random removals, one update each, only touched cells are summed, and the result
    equals the fresh one bit for bit.
    """
    body = ball_in_block(8, 42000.0)
    random = np.random.default_rng(0)
    for _ in range(1000):
        chosen = random.integers(0, len(body.particles.layer), 3)
        body.set_remaining(chosen, random.integers(0, 30000, 3))
        assert len(body.update().cells) <= 24
    left = np.empty_like(body.particles.remaining)
    left[body.cells.order] = body.cells.remaining
    arrays = body.particles
    fresh = ParticleBody(
        ParticleSet(
            arrays.position_m,
            arrays.volume_m3,
            arrays.modulus_Pa,
            arrays.poisson_ratio,
            arrays.layer,
            left,
        ),
        body.grid,
        body.supports,
    )
    assert np.array_equal(body.cells.cell_matrices(), fresh.cells.cell_matrices())
    assert np.array_equal(body.debris, fresh.debris)
    ours, theirs = body.matrix(), fresh.matrix()
    assert abs(ours - theirs).max() <= 1e-10 * abs(theirs).max()
    for level, other in zip(body._hierarchy.coarser, fresh._hierarchy.coarser, strict=True):
        difference = level.blocks.matrix() - other.blocks.matrix()
        assert abs(difference).max() <= 1e-10 * abs(other.blocks.matrix()).max()
