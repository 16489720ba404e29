"""Support compliance against closed forms.

They are a stiff block on springs and on a uniform elastic layer.
"""

import numpy as np
import pytest
from tooth_bodies import block

from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import NodeSupports, PointSprings
from tissue.models.tooth.recovery import support_compliance

EDGE = 1e-3
STIFF = 1e15  # [Pa], a million times what the supports are: the block moves as a rigid one to 1e-6


def test_stiff_block_on_springs():
    """A stiff block on springs has the exact stiffness.

    With springs S in any direction at random points it is K = sum R^T S R over them, about a point
    above, where the motions couple.
    """
    particles, grid = block((4, 4, 4), EDGE, modulus_Pa=STIFF)
    random = np.random.default_rng(3)
    points = EDGE * random.uniform(0.0, 4.0, (25, 3)) * [1.0, 1.0, 0.3]
    half = 100.0 * random.normal(size=(25, 3, 3))
    springs = PointSprings(points, half @ half.transpose(0, 2, 1))
    body = ParticleBody(particles, grid, NodeSupports.of(grid.node_count), springs=springs)
    reference = np.array([1e-3, 2e-3, 5e-3])
    found = support_compliance(
        body, weights=np.ones(grid.node_count), reference_m=reference, tolerance=1e-8
    )
    assert found.converged
    from tissue.fem.solvers.held_body import rigid_modes

    motions = rigid_modes(points, reference)
    wanted = np.linalg.inv(np.einsum("nik,nij,njl->kl", motions, springs.stiffness_N_m, motions))
    size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((found.matrix - wanted) / size).max() <= 1e-4
    assert np.array_equal(found.matrix, found.matrix.T)
    assert found.asymmetry <= 1e-6


def test_stiff_block_on_an_elastic_layer():
    """A stiff block on an elastic layer follows the closed form.

    The layer has Poisson's ratio 0 and thickness t and is held below: K_z = E A / t, K_x = G A / t,
    K_rz = G I_p / t. One layer of cells cannot bulge. Compression and shear therefore agree with
    the closed form to 1 %, which the free edge of a layer of twelve cells adds in shear.
    """
    soft, side = 50e6, 12
    particles, grid = block(
        (side, side, 4),
        EDGE,
        poisson_ratio=0.0,
        modulus_Pa=lambda x: np.where(x[:, 2] < EDGE, soft, STIFF),
    )
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    )
    weights = (grid.node_place[:, 2] >= 1).astype(float)
    reference = np.array([side * EDGE / 2, side * EDGE / 2, EDGE])
    found = support_compliance(body, weights=weights, reference_m=reference, tolerance=1e-7)
    area, polar = (side * EDGE) ** 2, (side * EDGE) ** 4 / 6.0
    wanted = EDGE / np.array([soft / 2 * area, soft / 2 * area, soft * area])
    assert found.converged
    assert np.linalg.eigvalsh(found.matrix)[0] > 0.0
    assert np.diag(found.matrix)[2] == pytest.approx(wanted[2], rel=0.01)
    assert 1.0 / np.linalg.inv(found.matrix)[[0, 1], [0, 1]] == pytest.approx(wanted[:2], rel=0.01)
    assert np.diag(found.matrix)[5] == pytest.approx(EDGE / (soft / 2 * polar), rel=0.01)
