"""Bars in series, the bilayer beam and the cantilever (validation cases 5 and 11)."""

import numpy as np
import pytest
from tooth_bodies import block, lattice, particle_stress

from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import NodeSupports


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
    # where 2 MPa lies beside 84 GPa, rounding of the stiff layer's displacement (1e-16 of it) is
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


def cantilever(through):
    edge = 1.0 / through
    particles, grid = block((10 * through, through, through), edge, modulus_Pa=1000.0)
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 0] == 0)
    )
    tip = grid.node_place[:, 0] == 10 * through
    inside = ((grid.node_place[:, 1:] > 0) & (grid.node_place[:, 1:] < through)).sum(axis=1)
    share = tip * 2.0**inside
    load = np.zeros((grid.node_count, 3))
    load[:, 2] = -share / share.sum()
    found = body.solve(load, tolerance=1e-8)
    assert found.converged
    return -found.displacement_m[tip, 2].mean()


def test_cantilever():
    """Case 5: 4.0312 (Timoshenko). The clamp holds the cross-section from bulging, 0.3 % here; 1 %
    with it.

    Trilinear cells lock in bending at order 2: two grids extrapolate.
    """
    coarse, fine = cantilever(3), cantilever(6)
    extrapolated = fine + (fine - coarse) / 3.0
    print(f"\ntip {coarse:.4f}, {fine:.4f}, extrapolated {extrapolated:.4f} against 4.0312")
    assert coarse < fine < 4.0312
    assert extrapolated == pytest.approx(4.0312, rel=0.01)
