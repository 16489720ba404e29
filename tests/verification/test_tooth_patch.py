"""Patch tests.

A linear field is exact on full cells, and where particles lie at random the error has its order.
"""

import numpy as np
import pytest
from tooth_bodies import GAUSS, block, lattice, on_boundary, particle_stress, slope

from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import NodeSupports

FIELD = np.array([[1.0, 0.3, -0.2], [0.1, -0.5, 0.4], [0.2, 0.6, 0.8]]) * 1e-3
EXACT = 1e-10
"""Relative error of an exact answer: rounding of a solve whose condition number is near 1e4."""


def patch_error(body):
    """Return the relative errors of inner displacements and stress.

    They are the root mean square of displacements and the largest of stress, over the largest value
    of each.
    """
    wanted = body.grid.node_position_m @ FIELD.T
    found = body.solve(np.zeros_like(wanted), tolerance=1e-13)
    stress, (first, shear) = (
        particle_stress(body.cells, found.displacement_m),
        body.particles.lame_Pa[0],
    )
    exact = first * np.trace(FIELD) * np.eye(3) + shear * (FIELD + FIELD.T)
    exact = exact[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    moved = (
        np.sqrt(((found.displacement_m - wanted)[~body.supports.fixed] ** 2).mean())
        / np.abs(wanted).max()
    )
    return moved, np.abs(stress - exact).max() / np.abs(exact).max(), found


def held_patch(particles, grid):
    held = on_boundary(grid)
    return ParticleBody(
        particles,
        grid,
        NodeSupports.of(grid.node_count, held=held, displacement_m=grid.node_position_m @ FIELD.T),
    )


@pytest.mark.parametrize(
    "places", [GAUSS, lattice(2), lattice(3)], ids=["gauss", "lattice 2", "lattice 3"]
)
def test_full_cells_are_exact(places):
    moved, stress, found = patch_error(
        held_patch(*block((6, 5, 4), 1e-3, modulus_Pa=18.6e9, places=places))
    )
    assert found.converged
    assert moved <= EXACT and stress <= EXACT


def random_patch(cells, per_cell, seed):
    random = np.random.default_rng(seed)
    places = random.uniform(size=(cells**3, per_cell, 3))
    return held_patch(*block((cells,) * 3, 1.0 / cells, modulus_Pa=1e9, places=places))


def test_random_particles_err_with_the_root_of_their_number():
    """The error of random particles falls with the root of their number.

    By Monte Carlo quadrature, the stress error falls as N^-1/2 (0.15: scatter of four points over
    12 seeds).
    """
    counts = np.array([8, 32, 128, 512])
    errors = [
        np.mean([patch_error(random_patch(4, int(n), seed))[1] for seed in range(3)])
        for n in counts
    ]
    print(
        "\nparticles a cell, largest stress error:",
        dict(zip(counts.tolist(), np.round(errors, 4), strict=True)),
    )
    assert slope(counts, errors) == pytest.approx(-0.5, abs=0.15)


def test_random_particles_still_converge_in_displacement():
    """Random particles still converge in displacement.

    At 8 particles a cell the stress error stays, but the displacement error falls with the edge:
    order 1.
    """
    cells = np.array([4, 8, 12])
    errors = [
        np.mean([patch_error(random_patch(int(n), 8, seed))[0] for seed in range(3)]) for n in cells
    ]
    print(
        "\ncells an edge, displacement error:",
        dict(zip(cells.tolist(), np.round(errors, 5), strict=True)),
    )
    assert slope(1.0 / cells, errors) >= 0.8
