"""Stress at particles, and its invariants, against plain NumPy."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation
from tooth_bodies import block

from kernels.particle_stress import principal_values
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.recovery import particle_stress, stress_invariants
from tissue.models.tooth.supports import NodeSupports


def deformed():
    random = np.random.default_rng(0)
    particles, grid = block(
        (3, 2, 2), 1e-3, modulus_Pa=lambda x: 10.0 ** random.uniform(6, 11, len(x))
    )
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    )
    return body, 1e-6 * random.normal(size=(grid.node_count, 3))


def test_particle_stress_against_numpy():
    body, moved = deformed()
    grid, edge = body.grid, body.grid.edge_m
    found = particle_stress(body.cells, moved)
    cell, place = grid.locate(body.particles.position_m)
    nodes = moved[grid.cell_nodes[cell]]
    step = 1e-7
    from tissue.models.tooth.grid import shape_values

    gradient = np.stack(
        [
            np.einsum(
                "pa,pai->pi",
                shape_values(place + step * axis) - shape_values(place - step * axis),
                nodes,
            )
            / (2.0 * step * edge)
            for axis in np.eye(3)
        ],
        axis=2,
    )
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    first, shear = body.particles.lame_Pa.T[:, :, None, None]
    stress = 2.0 * shear * strain + first * np.trace(strain, axis1=1, axis2=2)[
        :, None, None
    ] * np.eye(3)
    order = ([0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1])
    # 1e-7 of it: the central difference of a cubic, and rounding
    scale = np.abs(stress).max(axis=(1, 2))[:, None]
    assert (np.abs(found - stress[:, *order]) <= 1e-7 * scale).all()
    von_mises, principal = stress_invariants(found)
    assert (np.abs(principal - np.linalg.eigvalsh(stress)[:, ::-1]) <= 1e-6 * scale).all()
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    assert np.allclose(von_mises, np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))), rtol=1e-6)


@wp.kernel
def evaluate_principal(stress: wp.array(dtype=wp.mat33d), values_out: wp.array(dtype=wp.vec3d)):
    i = wp.tid()
    values_out[i] = principal_values(stress[i])


@pytest.mark.parametrize(
    "wanted",
    [(2.0, -1.0, -1.0), (1.0, 1.0, -2.0), (3.0, 0.0, 0.0), (5.0, 2.0, -4.0), (0.0, 0.0, 0.0)],
)
def test_principal_values_of_turned_matrices(wanted):
    """Principal values of turned matrices agree for 2,000 rotations.

    Where two values are equal, the cosine lies at the end of its range, where it may round over.
    """
    turns = Rotation.random(2000, random_state=0).as_matrix()
    stress = np.einsum("nij,j,nkj->nik", turns, wanted, turns)
    out = wp.zeros(len(stress), dtype=wp.vec3d, device="cpu")
    wp.launch(
        evaluate_principal,
        dim=len(stress),
        inputs=[wp.array(stress, dtype=wp.mat33d)],
        outputs=[out],
        device="cpu",
    )
    # the root of rounding
    assert out.numpy() == pytest.approx(np.broadcast_to(wanted, (2000, 3)), abs=1e-7)
