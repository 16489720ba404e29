"""Stiffness and stress of tetrahedra against plain NumPy and against scikit-fem."""

import numpy as np
import pytest
from tet_bodies import distorted
from tet_fields import isotropic, node_stress

from tissue.fem import assembly
from tissue.fem.assembly import assemble
from tissue.fem.fields import cell_stress, principal_stresses, von_mises
from tissue.fem.space import EDGES, Space
from tissue.materials.elasticity import lame, orthotropic, rotated

ROUNDING = 1e-13
"""Relative to the largest entry: sums of a few hundred terms in double precision."""

FOUR_POINTS = np.full((4, 4), (5.0 - np.sqrt(5.0)) / 20.0) + np.eye(4) * np.sqrt(5.0) / 5.0
"""Barycentric coordinates of the quadrature of degree 2 (Hammer and Stroud 1956)."""


def fibrous(count, seed=0):
    """An orthotropic material turned at random in each cell, shape (m, 6, 6)."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))[0]
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]
    matrix = orthotropic(
        young_Pa=(12e9, 13.4e9, 20e9),
        shear_Pa=(4.53e9, 5.61e9, 6.23e9),
        poisson_ratio=(0.376, 0.222, 0.235),
    )
    return rotated(matrix, axes)


def mixed(count, seed=0):
    random = np.random.default_rng(seed)
    return lame(10.0 ** random.uniform(3, 9, count), random.uniform(-0.5, 0.49, count))


MATERIALS = {
    "one isotropic": lambda count: lame(5e3, 0.45),
    "one matrix": lambda count: isotropic(5e3, 0.45),
    "isotropic by cell": mixed,
    "fibrous by cell": fibrous,
}


def strain_matrices(space, cell, at):
    """Return B of a cell at barycentric coordinates, shape (6, nodes, 3).

    It gives engineering strains in the order xx ... xy.
    """
    corners = space.mesh.nodes_m[space.mesh.cells[cell]]
    g = np.linalg.inv(np.vstack([np.ones(4), corners.T]))[:, 1:]
    if space.order == 2:
        g = np.vstack(
            [(4.0 * at[:, None] - 1.0) * g, [4.0 * (at[i] * g[j] + at[j] * g[i]) for i, j in EDGES]]
        )
    b = np.zeros((6, len(g), 3))
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        b[k, :, i] += g[:, j]
        if i != j:
            b[k, :, j] += g[:, i]
    return b


def by_numpy(space, elasticity):
    """Dense matrix, cell by cell and point by point."""
    total = np.zeros((space.unknown_count,) * 2)
    rows = np.asarray(elasticity)
    if rows.shape[-1] == 2:
        rows = np.array([isotropic_of(pair) for pair in rows.reshape(-1, 2)])
    rows = np.broadcast_to(rows.reshape(-1, 6, 6), (space.cell_count, 6, 6))
    for cell, nodes in enumerate(space.cell_nodes):
        b = np.array([strain_matrices(space, cell, at).reshape(6, -1) for at in FOUR_POINTS])
        place = (3 * nodes[:, None] + np.arange(3)).ravel()
        share = space.mesh.volumes_m3[cell] / 4.0
        total[np.ix_(place, place)] += share * np.einsum("pia,ij,pjb->ab", b, rows[cell], b)
    return total


def isotropic_of(pair):
    first, shear = pair
    ratio = first / (2.0 * (first + shear))
    return isotropic(2.0 * shear * (1.0 + ratio), ratio)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("material", MATERIALS)
def test_matrix_against_numpy(order, material):
    space = Space(distorted(2), order)
    elasticity = MATERIALS[material](space.cell_count)
    wanted = by_numpy(space, elasticity)
    found = assemble(space, elasticity).toarray()
    assert np.abs(found - wanted).max() <= ROUNDING * np.abs(wanted).max()


@pytest.mark.parametrize("order", [1, 2])
def test_softened_cells_resist_a_mean_change_of_volume(order):
    """The first Lame constant beyond the shear modulus acts on the mean strain of a cell."""
    space = Space(distorted(2), order)
    first, shear = lame(5e3, 0.49)
    kept = assembly.SOFTENED_RATIO * shear
    wanted = by_numpy(space, np.array([kept, shear]))
    for cell, nodes in enumerate(space.cell_nodes):
        b = np.array([strain_matrices(space, cell, at).reshape(6, -1) for at in FOUR_POINTS])
        mean = b[:, :3].sum(axis=1).mean(axis=0)
        place = (3 * nodes[:, None] + np.arange(3)).ravel()
        volume = space.mesh.volumes_m3[cell]
        wanted[np.ix_(place, place)] += volume * (first - kept) * np.outer(mean, mean)
    for elasticity in ((first, shear), isotropic(5e3, 0.49)):
        found = assemble(space, elasticity, softened=True).toarray()
        assert np.abs(found - wanted).max() <= ROUNDING * np.abs(wanted).max()
        assert np.linalg.eigvalsh(found)[6] > 1e-6 * np.abs(found).max()


def test_cells_far_from_incompressible_are_not_softened():
    space = Space(distorted(2), 2)
    elasticity = lame(5e3, 0.25 - 1e-9)
    exact = assemble(space, elasticity)
    assert np.array_equal(exact.data, assemble(space, elasticity, softened=True).data)


def test_softened_fibrous_cells_stay_positive_definite():
    space = Space(distorted(2), 2)
    found = assemble(space, fibrous(space.cell_count), softened=True).toarray()
    # Six rigid motions have no stiffness.
    values = np.linalg.eigvalsh(found)
    assert np.abs(values[:6]).max() < 1e-9 * values[-1] < values[6]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("material", MATERIALS)
def test_matrix_equals_its_transpose_bitwise(order, material):
    space = Space(distorted(4), order)
    matrix = assemble(space, MATERIALS[material](space.cell_count))
    turned = matrix.T.tobsr((3, 3))
    turned.sort_indices()
    assert matrix.blocksize == (3, 3) and matrix.has_sorted_indices
    assert np.array_equal(matrix.indptr, turned.indptr) and np.array_equal(
        matrix.indices, turned.indices
    )
    assert np.array_equal(matrix.data, turned.data)


@pytest.mark.parametrize("order", [1, 2])
def test_stress_against_numpy(order):
    space = Space(distorted(2), order)
    material = fibrous(space.cell_count)
    moved = np.random.default_rng(1).normal(size=(space.node_count, 3))
    found = cell_stress(space, moved, material)
    middle = np.full(4, 0.25)
    strain = np.array(
        [
            np.einsum("kai,ai->k", strain_matrices(space, cell, middle), moved[nodes])
            for cell, nodes in enumerate(space.cell_nodes)
        ]
    )
    stress = np.einsum("mij,mj->mi", material, strain)
    tensor = stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    size = np.abs(stress).max()
    assert np.allclose(
        found.strain,
        strain * [1, 1, 1, 0.5, 0.5, 0.5],
        atol=ROUNDING * np.abs(strain).max(),
        rtol=0,
    )
    assert np.abs(found.stress_Pa - stress).max() <= ROUNDING * size
    assert (
        np.abs(principal_stresses(found.stress_Pa) - np.linalg.eigvalsh(tensor)[:, ::-1]).max()
        <= 1e-12 * size
    )
    deviator = tensor - np.trace(tensor, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    assert np.allclose(
        von_mises(found.stress_Pa), np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))), rtol=1e-10
    )


@pytest.mark.parametrize("order", [1, 2])
def test_node_stress_is_the_mean_over_cells_by_volume(order):
    space = Space(distorted(2), order)
    moved = np.random.default_rng(1).normal(size=(space.node_count, 3))
    material = mixed(space.cell_count)
    found = node_stress(space, moved, material)
    places = np.vstack([np.eye(4), np.eye(4)[EDGES].mean(axis=1)])
    for node in (0, 13, space.node_count - 1):
        total, weight = np.zeros(6), 0.0
        for cell, local in np.argwhere(space.cell_nodes == node):
            strain = np.einsum(
                "kai,ai->k",
                strain_matrices(space, cell, places[local]),
                moved[space.cell_nodes[cell]],
            )
            total += space.volumes_m3[cell] * isotropic_of(material[cell]) @ strain
            weight += space.volumes_m3[cell]
        assert np.allclose(
            found.stress_Pa[node],
            total / weight,
            rtol=1e-10,
            atol=1e-10 * np.abs(found.stress_Pa).max(),
        )


def test_quadratic_field_has_its_linear_stress_at_nodes():
    """A quadratic field has its linear stress at nodes.

    u = (x^2, x y, z^2 / 2): the quadratic space holds it, and smoothing leaves a linear stress
    alone.
    """
    space = Space(distorted(3), 2)
    x, y, z = space.nodes_m.T
    found = node_stress(space, np.column_stack([x * x, x * y, 0.5 * z * z]), lame(1.0, 0.25)).strain
    wanted = np.column_stack([2 * x, x, z, 0 * x, 0 * x, 0.5 * y])
    assert np.abs(found - wanted).max() < 1e-12
