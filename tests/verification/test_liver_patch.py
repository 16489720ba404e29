"""Patch test, rigid modes and energy (validation case 1).

Energy is compared with force and stiffness, and frame invariance is checked.
"""

import numpy as np
import pytest
from tet_bodies import distorted, planes, slope, solve, solve_iteratively

from meshes.tets.structured import box
from tissue.fem.assembly import assemble, capsule_stiffness
from tissue.fem.fields import cell_stress
from tissue.fem.space import EDGES, Space, gradient_slopes
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


FIRST, SHEAR = lame(1.0, 0.3)


AMPLITUDE = np.array([1.0, -0.5, 0.7])


def quadrature(points):
    """Return the conical product rule on the tetrahedron, of degree 2 points - 2 or more.

    The result is barycentric coordinates and weights of mean 1.
    """
    at, weight = np.polynomial.legendre.leggauss(points)
    at, weight = 0.5 * (at + 1.0), 0.5 * weight
    a, b, c = np.meshgrid(at, at, at, indexing="ij")
    w = np.einsum("i,j,k->ijk", weight * (1 - at) ** 2, weight * (1 - at), weight) * 6.0
    x, y, z = a, b * (1 - a), c * (1 - a) * (1 - b)
    return np.stack([1 - x - y - z, x, y, z], axis=-1).reshape(-1, 4), w.ravel()


def shape_values(barycentric, order):
    """Return the shape functions of the nodes at points, shape (..., nodes).

    They are l_A, or l_A (2 l_A - 1) and 4 l_i l_j on the edges.
    """
    if order == 1:
        return barycentric
    i, j = np.array(EDGES).T
    at_corners = barycentric * (2.0 * barycentric - 1.0)
    return np.concatenate([at_corners, 4.0 * barycentric[..., i] * barycentric[..., j]], axis=-1)


def displacement(x):
    return np.sin(np.pi * x).prod(axis=-1)[..., None] * AMPLITUDE


def gradient(x):
    """du_i / dx_j."""
    sine, cosine = np.sin(np.pi * x), np.cos(np.pi * x)
    each = [
        np.pi * cosine[..., j] * sine[..., (j + 1) % 3] * sine[..., (j + 2) % 3] for j in range(3)
    ]
    return AMPLITUDE[:, None] * np.stack(each, axis=-1)[..., None, :]


def body_force(x):
    """-div sigma = -(lambda + mu) grad div u - mu laplace u."""
    sine, cosine = np.sin(np.pi * x), np.cos(np.pi * x)
    second = np.empty((*x.shape[:-1], 3, 3))
    for i in range(3):
        for j in range(3):
            k = 3 - i - j
            second[..., i, j] = (
                -sine.prod(axis=-1) if i == j else cosine[..., i] * cosine[..., j] * sine[..., k]
            )
    second *= np.pi**2
    return -(FIRST + SHEAR) * second @ AMPLITUDE + 3.0 * np.pi**2 * SHEAR * displacement(x)


def errors(order, cells):
    """Return the L2 errors of the displacement and of its gradient.

    They are relative to the norms of the exact fields.
    """
    space = Space(box((1.0, 1.0, 1.0), (cells,) * 3), order)
    at, weight = quadrature(order + 2)
    corners = space.mesh.nodes_m[space.mesh.cells]
    x = np.einsum("pc,mci->mpi", at, corners)
    share = space.mesh.volumes_m3[:, None] * weight
    shapes = shape_values(at, order)
    local = np.einsum("mp,mpi,pa->mai", share, body_force(x), shapes, optimize=True).reshape(-1, 3)
    nodes = space.cell_nodes.ravel()
    load = np.stack([np.bincount(nodes, local[:, i], space.node_count) for i in range(3)], axis=1)
    outside = ((space.nodes_m < 1e-9) | (space.nodes_m > 1.0 - 1e-9)).any(axis=1)
    found = solve_iteratively(
        assemble(space, (FIRST, SHEAR)), load, np.repeat(outside[:, None], 3, axis=1)
    )
    at_cells = found[space.cell_nodes]
    moved = np.einsum("pa,mai->mpi", shapes, at_cells)
    along = np.einsum(
        "aci,pi,mcj->mpaj", gradient_slopes(4, order), at, space.gradients[0].numpy(), optimize=True
    )
    slopes = np.einsum("mai,mpaj->mpij", at_cells, along, optimize=True)
    zero = np.sqrt(
        (share[..., None] * (moved - displacement(x)) ** 2).sum()
        / (share[..., None] * displacement(x) ** 2).sum()
    )
    one = np.sqrt(
        (share[..., None, None] * (slopes - gradient(x)) ** 2).sum()
        / (share[..., None, None] * gradient(x) ** 2).sum()
    )
    return zero, one


@pytest.mark.parametrize(
    ("order", "cells", "bounds"),
    [(1, (10, 13, 16), (0.022, 0.14)), (2, (4, 6, 8), (0.0023, 0.026))],
    ids=["linear", "quadratic"],
)
@pytest.mark.slow
def test_slopes_and_bounds(order, cells, bounds):
    """Errors have the expected slopes and bounds.

    Orders are p + 1 in displacement and p in strain, within 0.1; bounds on the finest mesh are a
    tenth above the measured errors.
    """
    zero, one = np.array([errors(order, n) for n in cells]).T
    size = 1.0 / np.array(cells)
    print(
        f"\nP{order}: L2 {zero}, slope {slope(size, zero):.3f}; H1 {one}, slope "
        f"{slope(size, one):.3f}"
    )
    assert slope(size, zero) == pytest.approx(order + 1, abs=0.1)
    assert slope(size, one) == pytest.approx(order, abs=0.1)
    assert zero[-1] < bounds[0] and one[-1] < bounds[1]
