"""Patch test, rigid modes and energy (validation case 1).

Energy is compared with force and stiffness, and frame invariance is checked.
"""

import numpy as np
import pytest
from tet_bodies import distorted, planes, solve
from tet_fields import isotropic

from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble, capsule_stiffness
from tissue.fem.fields import cell_stress
from tissue.fem.space import Space
from tissue.materials.elasticity import lame, orthotropic, rotated, transversely_isotropic

FIELD = np.array([[1.0, 0.3, -0.2], [0.1, -0.7, 0.4], [-0.5, 0.2, 0.6]]) * 1e-3
EXACT = 1e-12
"""Of the exact answer: rounding of a solve whose condition number is near 1e3."""

BONE = orthotropic(
    young_Pa=(12e9, 13.4e9, 20e9),
    shear_Pa=(4.53e9, 5.61e9, 6.23e9),
    poisson_ratio=(0.376, 0.222, 0.235),
)
MUSCLE = transversely_isotropic(
    young_fibre_Pa=2e5,
    young_across_Pa=2e4,
    shear_fibre_Pa=1e4,
    poisson_fibre=0.4,
    poisson_across=0.3,
)
LAWS = {
    "isotropic": lame(5e3, 0.45),
    "transversely isotropic": rotated(MUSCLE, [[1.0, 2.0, -1.0]])[0],
    "orthotropic": BONE,
}


def turned_by(seed):
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.linalg.det(matrix)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_linear_field_is_exact_on_a_distorted_mesh(order, law):
    space = Space(distorted(4, amount=0.25), order)
    wanted = space.nodes_m @ FIELD.T
    outside = ((space.nodes_m < 1e-9) | (space.nodes_m > 1.0 - 1e-9)).any(axis=1)
    held = np.repeat(outside[:, None], 3, axis=1)
    found = solve(assemble(space, LAWS[law]), np.zeros_like(wanted), held, wanted)
    assert np.abs(found - wanted).max() <= EXACT * np.abs(wanted).max()
    strain = cell_stress(space, found, LAWS[law]).strain
    exact = (0.5 * (FIELD + FIELD.T))[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    # strain divides differences of displacement by the smallest height of a cell, about a twentieth
    # of the body
    assert np.abs(strain - exact).max() <= 20 * EXACT * np.abs(exact).max()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("capsule", [False, True])
def test_six_rigid_modes_and_none_after_supports(order, law, capsule):
    space = Space(distorted(2), order)
    matrix = assemble(space, LAWS[law])
    if capsule:
        matrix = matrix + capsule_stiffness(
            space, thickness_m=0.01, young_Pa=1e6, poisson_ratio=0.4
        )
    values = np.linalg.eigvalsh(matrix.toarray())
    assert np.abs(values[:6]).max() < 1e-13 * values[-1] and values[6] > 1e-5 * values[-1]
    free = ~planes(space, x=0.0, y=0.0, z=0.0).ravel()
    assert np.linalg.eigvalsh(matrix.toarray()[np.ix_(free, free)])[0] > 1e-5 * values[-1]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_energy_force_and_stiffness_agree(order, law):
    """Energy, force and stiffness agree.

    Force is the slope of the energy, stiffness the slope of the force; the energy is the strain
    energy, cell by cell. Central differences of a quadratic are exact except for rounding: 1e-9 at
    a step of 1e-3.
    """
    space, random = Space(distorted(2), order), np.random.default_rng(3)
    matrix, (u, along) = assemble(space, LAWS[law]), random.normal(size=(2, space.node_count, 3))
    if order == 1:
        at = cell_stress(space, u, LAWS[law])
        work = (at.stress_Pa * at.strain * [1, 1, 1, 2, 2, 2]).sum(axis=1)
        assert 0.5 * u.ravel() @ matrix @ u.ravel() == pytest.approx(
            0.5 * (space.volumes_m3 * work).sum(), rel=1e-12
        )

    def energy(displacement):
        return 0.5 * displacement.ravel() @ (matrix @ displacement.ravel())

    step = 1e-3
    force = (energy(u + step * along) - energy(u - step * along)) / (2.0 * step)
    assert force == pytest.approx((matrix @ u.ravel()) @ along.ravel(), rel=1e-9)
    change = (matrix @ (u + step * along).ravel() - matrix @ (u - step * along).ravel()) / (
        2.0 * step
    )
    assert np.abs(change - matrix @ along.ravel()).max() <= 1e-9 * np.abs(change).max()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_turned_body_has_the_turned_matrix(order, law):
    """K(R x) = R K(x) R^T, with the material turned along and a capsule on."""
    mesh, rotation = distorted(3), turned_by(5)
    material = isotropic(5e3, 0.45) if law == "isotropic" else LAWS[law]
    matrices = []
    for nodes, stiffness in (
        (mesh.nodes_m, material),
        (mesh.nodes_m @ rotation.T, rotated(material, rotation[None])[0]),
    ):
        space = Space(TetMesh(nodes, mesh.cells), order)
        skin = capsule_stiffness(
            space, thickness_m=0.1, young_Pa=np.abs(material).max(), poisson_ratio=0.3
        )
        matrices.append((assemble(space, stiffness) + skin).toarray())
    turn = np.kron(np.eye(space.node_count), rotation)
    off = np.abs(matrices[1] - turn @ matrices[0] @ turn.T).max() / np.abs(matrices[0]).max()
    assert off <= 1e-13


def test_error_of_the_linear_law_under_a_rotation():
    """A rigid rotation by t should cost no force. The linear law sees the strain (cos t - 1) across
    the axis: t^2 / 2.

    Stress of that false strain in plane, over E: (1 - cos t) / ((1 + nu) (1 - 2 nu)); 17 % strain
    at 34 degrees.
    """
    space, ratio = Space(distorted(3), 1), 0.45
    print()
    for degrees in (1.0, 5.0, 10.0, 30.0):
        t = np.radians(degrees)
        rotation = np.array(
            [[np.cos(t), -np.sin(t), 0.0], [np.sin(t), np.cos(t), 0.0], [0.0, 0.0, 1.0]]
        )
        found = cell_stress(space, space.nodes_m @ (rotation - np.eye(3)).T, lame(1.0, ratio))
        print(
            f"rotation {degrees:4.0f} degrees: strain {np.abs(found.strain).max():.2e}, "
            f"stress / E {np.abs(found.stress_Pa).max():.2e}"
        )
        assert np.allclose(found.strain[:, :2], np.cos(t) - 1.0, rtol=1e-9)
        wanted = (1.0 - np.cos(t)) / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        assert np.allclose(found.stress_Pa[:, :2], -wanted, rtol=1e-9)
