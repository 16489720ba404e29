"""Compliance of the nodes that a tool may touch, by each of its paths.

The reference is NumPy's dense inverse.
"""

import numpy as np
import pytest
from held_cube import BOTTOM, SURFACE, body_of

from meshes.base.progress import silent
from tissue.fem.solvers.compliance import LazyCompliance
from tissue.models.organ.compliance import Factor, KeptColumns, compliance_of

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


@pytest.mark.parametrize(
    ("path", "basis_size"), [("condensed", 5), ("reduced", 3 * len(TOUCHABLE)), ("reduced", 10**6)]
)
def test_a_whole_compliance_is_the_inverse_stiffness_at_the_touchable_nodes(
    path, basis_size, exact
):
    """A basis of all unknowns leaves nothing out, and one larger than that is one of all."""
    body = body_of()
    found, lazy = compliance_of(
        body, TOUCHABLE, Factor(body), path=path, basis_size=basis_size, report=silent
    )
    assert lazy is None
    assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


def test_a_small_basis_keeps_the_largest_eigenvalues_and_each_node_s_own_block(exact):
    body = body_of()
    found, _ = compliance_of(
        body, TOUCHABLE, Factor(body), path="reduced", basis_size=6, report=silent
    )
    values, vectors = np.linalg.eigh(exact)
    wanted = (vectors[:, -6:] * values[-6:]) @ vectors[:, -6:].T
    for node in range(len(TOUCHABLE)):
        part = slice(3 * node, 3 * node + 3)
        wanted[part, part] = exact[part, part]
    assert found == pytest.approx(wanted, abs=1e-9 * np.abs(exact).max())


def test_a_lazy_compliance_holds_nothing_until_it_is_asked(exact):
    body = body_of()
    factor = Factor(body)
    factor.expect(TOUCHABLE)
    found, lazy = compliance_of(body, TOUCHABLE, factor, path="lazy", basis_size=5, report=silent)
    assert isinstance(lazy, LazyCompliance) and np.isnan(found).all() and found.shape == exact.shape
    lazy.want(np.arange(len(TOUCHABLE)))
    lazy.fill()
    while lazy.pour(found):
        pass
    assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


def test_kept_columns_are_the_inverse_stiffness_and_stay(exact):
    kept = KeptColumns(Factor(body_of()), np.sort(SURFACE))
    order = np.array([2, 0, 1])
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    for _ in range(2):
        found = kept.between(TOUCHABLE[order])
        assert found == pytest.approx(exact[np.ix_(rows, rows)], abs=1e-9 * np.abs(exact).max())
        assert np.array_equal(found, found.T)
