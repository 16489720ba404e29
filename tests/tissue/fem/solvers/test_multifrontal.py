"""Multifrontal factor against scipy's spsolve and dense inverses.

It is tested over meshes, orders, blocks and right sides.
"""

import numpy as np
import pytest
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.solvers.direct import DirectSolver, dissected
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.solvers.multifrontal import Multifrontal, NotPositiveDefiniteError
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

ROUNDING = 1e-10
"""Two exact solutions differ by rounding times the condition number, some 1e4 here."""
BODIES = {"slab": ((0.2, 0.2, 0.02), (12, 12, 2)), "block": ((0.1, 0.1, 0.1), (7, 7, 7))}


def body_of(name="block", ratio=0.45):
    """Held at its base."""
    mesh = box(*BODIES[name])
    space = Space(mesh)
    return HeldBody(
        assemble(space, lame(5e3, ratio)), mesh.nodes_m, held_nodes(mesh.nodes_m[:, 2] < 1e-9)
    )


def spd(matrix):
    """The matrix with 1 more on its diagonal than Gershgorin's circles need."""
    half = csc_array(np.triu(matrix, 1))
    both = half + half.T
    return csc_array(both + csc_array(np.diag(1.0 + np.abs(both).sum(axis=0))))


def random_mesh(seed, count=300):
    """Return a random symmetric positive definite matrix, its order and its blocks.

    The matrix couples neighbours in a cloud.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(count, 3)) * rng.uniform(0.2, 1.0, 3)
    _, near = cKDTree(points).query(points, k=8)
    dense = np.zeros((count, count))
    dense[np.arange(count)[:, None], near] = rng.normal(size=near.shape)
    matrix = spd(dense + dense.T)
    blocks = dissected(points, csc_array(matrix != 0).tocsr())
    order = np.concatenate(blocks)
    return csc_array(matrix[order][:, order]), np.cumsum([0, *map(len, blocks)])


def assert_solves(matrix, starts, right):
    found = Multifrontal(matrix, starts).solve(right)
    exact = spsolve(matrix, right).reshape(found.shape)
    assert found.shape == right.shape
    np.testing.assert_allclose(found, exact, rtol=0, atol=ROUNDING * np.abs(exact).max())
    assert np.linalg.norm(matrix @ found - right) <= 1e-12 * np.linalg.norm(right)


@pytest.mark.parametrize("seed", range(6))
def test_random_meshes_as_spsolve(seed):
    matrix, starts = random_mesh(seed)
    assert_solves(matrix, starts, np.random.default_rng(seed).normal(size=len(matrix.indptr) - 1))


@pytest.mark.parametrize("ratio", [0.3, 0.49])
@pytest.mark.parametrize("name", BODIES)
def test_elastic_bodies_as_spsolve_with_a_small_residual(name, ratio):
    body = body_of(name, ratio)
    load = np.random.default_rng(0).normal(size=body.nodes_m.shape) * ~body.fixed
    solver = DirectSolver(body)
    found = solver.solve(load)
    exact = body.whole(
        spsolve(body.stiffness.tocsr()[body.free][:, body.free].tocsc(), body.right_side(load))
    )
    np.testing.assert_allclose(
        found.displacement_m, exact, rtol=0, atol=ROUNDING * np.abs(exact).max()
    )
    assert found.converged and found.residual < 1e-11


def test_a_factor_in_single_precision_solves_to_single_precision():
    body = body_of(next(iter(BODIES)), 0.49)
    load = np.random.default_rng(0).normal(size=body.nodes_m.shape) * ~body.fixed
    exact = DirectSolver(body).displacement_m(load)
    single = DirectSolver(body, single=True)
    found = single.displacement_m(load)
    size = np.abs(exact).max()
    assert 1e-9 * size < np.abs(found - exact).max() < 1e-4 * size
    assert not single.solve(load).converged


def test_many_right_sides_are_each_alone():
    matrix, starts = random_mesh(7)
    factor = Multifrontal(matrix, starts)
    right = np.random.default_rng(3).normal(size=(matrix.shape[0], 37))
    right[:, 5] = 0.0
    right[:-1, 6] = 0.0
    kept = right.copy()
    found = factor.solve(right)
    np.testing.assert_array_equal(right, kept)
    for column in range(37):
        alone = factor.solve(right[:, column])
        np.testing.assert_allclose(
            found[:, column], alone, rtol=0, atol=1e-14 * np.abs(found).max()
        )
    assert not found[:, 5].any()
    assert factor.solve(right[:, :0]).shape == (matrix.shape[0], 0)


def test_the_inverse_of_what_is_eliminated_last():
    """Of the block and of a part of it."""
    matrix, starts = random_mesh(5)
    factor = Multifrontal(matrix, starts)
    count = int(starts[-1] - starts[-2])
    inverse = np.linalg.inv(matrix.toarray())
    for last in (count, 1):
        found = factor.inverse_of_last(last)
        np.testing.assert_array_equal(found, found.T)
        np.testing.assert_allclose(found, inverse[-last:, -last:], rtol=0, atol=1e-13)


def test_a_matrix_that_is_not_positive_definite_names_its_unknown():
    matrix, starts = random_mesh(8)
    matrix = csc_array(matrix - 2.0 * csc_array(np.diag(np.eye(300)[17] * matrix.diagonal())))
    with pytest.raises(NotPositiveDefiniteError, match="at unknown"):
        Multifrontal(matrix, starts)


def test_the_compliance_between_nodes_is_that_of_the_inverse():
    """Nodes that were eliminated last, and others."""
    body = body_of()
    nodes = np.flatnonzero(~body.fixed.any(axis=1))[:7]
    inverse = np.zeros((3 * len(body.nodes_m),) * 2)
    free = np.ix_(body.free, body.free)
    inverse[free] = np.linalg.inv(body.stiffness.toarray()[free])
    rows = (3 * nodes[:, None] + np.arange(3)).ravel()
    wanted = inverse[np.ix_(rows, rows)]
    for last in (nodes, nodes[:2]):
        found = DirectSolver(body, last=last).compliance_between(nodes)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
