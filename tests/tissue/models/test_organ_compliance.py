"""Compliance of the nodes that a tool may touch, by each of its paths.

The reference is NumPy's dense inverse.
"""

import numpy as np
import pytest
from held_cube import BOTTOM, SURFACE, body_of

from tissue.fem.solvers.compliance import CHUNK, reduced_compliance_m_N, surface_compliance_m_N
from tissue.fem.solvers.direct import TOGETHER, DirectSolver
from tissue.fem.solvers.held_body import components_of
from tissue.models.organ.compliance import Factor

TOUCHABLE = SURFACE[~BOTTOM[SURFACE]][::9]


@pytest.fixture(autouse=True)
def fresh_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))


@pytest.fixture(scope="module")
def exact():
    body = body_of()
    inverse = np.linalg.inv(body.stiffness.toarray()[np.ix_(body.free, body.free)])
    place = np.full(3 * len(body.nodes_m), -1)
    place[body.free] = np.arange(len(body.free))
    rows = place[(3 * TOUCHABLE[:, None] + np.arange(3)).ravel()]
    return inverse[np.ix_(rows, rows)]


def test_a_whole_compliance_is_the_inverse_stiffness_at_the_touchable_nodes(exact):
    found = surface_compliance_m_N(body_of(), TOUCHABLE)
    assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("size", [3 * len(TOUCHABLE), 10**6])
def test_a_basis_of_all_unknowns_leaves_nothing_out(size, exact):
    """A basis that is larger than the number of unknowns is a basis of all of them."""
    found = reduced_compliance_m_N(DirectSolver(body_of()), TOUCHABLE, size)
    assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


def test_a_small_basis_keeps_the_largest_eigenvalues_and_each_node_s_own_block(exact):
    found = reduced_compliance_m_N(DirectSolver(body_of()), TOUCHABLE, 6)
    values, vectors = np.linalg.eigh(exact)
    wanted = (vectors[:, -6:] * values[-6:]) @ vectors[:, -6:].T
    for node in range(len(TOUCHABLE)):
        part = slice(3 * node, 3 * node + 3)
        wanted[part, part] = exact[part, part]
    assert found == pytest.approx(wanted, abs=1e-9 * np.abs(exact).max())


def test_stored_columns_are_the_inverse_stiffness_and_stay(exact):
    factor = Factor(body_of(), np.sort(SURFACE))
    order = np.array([2, 0, 1])
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    for _ in range(2):
        found = factor.compliance_between(TOUCHABLE[order])
        assert found == pytest.approx(exact[np.ix_(rows, rows)], abs=1e-9 * np.abs(exact).max())
        assert np.array_equal(found, found.T)


def test_columns_of_several_blocks_are_the_inverse_stiffness():
    """Compliance between more nodes than one block of columns contains.

    The factor and the solver compute it. The tolerance is that of the factorisation.
    """
    body = body_of()
    nodes = np.sort(SURFACE[~BOTTOM[SURFACE]])[::2]
    assert 3 * len(nodes) > 2 * max(CHUNK, TOGETHER)
    inverse = np.zeros([3 * len(body.nodes_m)] * 2)
    free = np.ix_(body.free, body.free)
    inverse[free] = np.linalg.inv(body.stiffness.toarray()[free])
    rows = components_of(nodes)
    exact = inverse[np.ix_(rows, rows)]
    for solver in (Factor(body, np.sort(SURFACE)), DirectSolver(body)):
        found = solver.compliance_between(nodes)
        assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())
