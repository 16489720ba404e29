"""Patch tests.

A linear field is exact on full cells, and where particles lie at random the error has its order.
"""

import numpy as np
import pytest
from tooth_bodies import GAUSS, block, lattice, on_boundary, particle_stress

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


def test_bars_in_series_are_exact():
    """Bars in series are exact.

    Three bars between two plates have E_eff = sum h / sum (h / E), over a contrast of enamel to
    pulp.
    """
    moduli, parts, edge = np.array([84e9, 2e6, 18.6e9]), np.array([2, 3, 4]), 1e-3
    ends = np.cumsum(parts) * edge
    particles, grid = block(
        (2, 2, 9),
        edge,
        modulus_Pa=lambda x: moduli[np.searchsorted(ends, x[:, 2])],
        poisson_ratio=0.0,
    )
    height, area, stretch = ends[-1], 4.0 * edge**2, 1e-6
    top = grid.node_place[:, 2] == 9
    held = np.zeros((grid.node_count, 3), dtype=bool)
    held[top | (grid.node_place[:, 2] == 0)] = True
    supports = NodeSupports.of(
        grid.node_count, held=held, displacement_m=np.where(top[:, None], [0.0, 0.0, stretch], 0.0)
    )
    body = ParticleBody(particles, grid, supports)
    found = body.solve(np.zeros_like(supports.displacement_m), tolerance=1e-13)
    force = body.product(found.displacement_m)[top, 2].sum()
    effective = height / (parts * edge / moduli).sum()
    assert force == pytest.approx(effective * area * stretch / height, rel=1e-10)
    stress = particle_stress(body.cells, found.displacement_m)[:, 2]
    # where 2 MPa lies next to 84 GPa, rounding of the stiff layer's displacement (1e-16 of it) is
    # 4e-12 of its strain
    assert np.allclose(stress, effective * stretch / height, rtol=1e-6)


def test_bilayer_beam():
    """The bilayer beam follows the closed form.

    Its contrast is 100:1, stiff on top, and its ends bend it about the axis .745050 from the soft
    face: EI = 1.175846, no axial force. The ends turn without warping, so with Poisson's ratio 0
    the exact field is pure bending. There are 16 cells in the height with 4^3 particles each. The
    case's tolerance is 1 %; trilinear cells stiffen bending by 1 / (2 n^2) of each layer.
    """
    through, length, axis, turn = 16, 1.0, 0.745050, 1e-3
    edge = 1.0 / through
    particles, grid = block(
        (through, 2, through),
        edge,
        modulus_Pa=lambda x: np.where(x[:, 2] > 0.5, 100.0, 1.0),
        poisson_ratio=0.0,
        places=lattice(4),
    )
    ends = (grid.node_place[:, 0] == 0) | (grid.node_place[:, 0] == through)
    held = np.zeros((grid.node_count, 3), dtype=bool)
    held[ends, 0] = True
    held[(grid.node_place == 0).all(axis=1)] = True
    held[(grid.node_place == [0, 2, 0]).all(axis=1), 2] = True
    held[(grid.node_place == [through, 0, 0]).all(axis=1), 1] = True
    moved = np.zeros((grid.node_count, 3))
    side = np.where(grid.node_place[:, 0] == 0, -0.5, 0.5)
    moved[:, 0] = -turn * side * (grid.node_position_m[:, 2] - axis)
    moved[:, 1:] = 0.0
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=held, displacement_m=moved)
    )
    found = body.solve(np.zeros_like(moved), tolerance=1e-8)
    assert found.converged
    force = body.product(found.displacement_m)
    right = grid.node_place[:, 0] == through
    width = 2.0 * edge
    moment = -(force[right, 0] * (grid.node_position_m[right, 2] - axis)).sum() / width
    axial = force[right, 0].sum() / width
    stiffness = moment * length / turn
    print(f"\nEI {stiffness:.5f} against 1.175846; axial force over moment {axial / moment:.1e}")
    assert stiffness == pytest.approx(1.175846, rel=0.01)
    assert abs(axial) < 0.01 * moment
