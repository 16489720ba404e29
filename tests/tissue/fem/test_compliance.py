"""Compliance of touchable nodes, read from a factor or computed by back-substitutions."""

import numpy as np
import pytest
from held_cube import BOTTOM, SURFACE, body_of

from meshes.base.errors import InputError
from tissue.fem.solvers import compliance
from tissue.fem.solvers.compliance import surface_compliance_m_N


@pytest.fixture(autouse=True)
def fresh_cache(tmp_path, monkeypatch):
    """A cache of its own for every test."""
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))


def test_the_compliance_is_found_once_symmetric_and_positive(monkeypatch):
    body = body_of()
    free = SURFACE[~BOTTOM[SURFACE]]
    first = surface_compliance_m_N(body, free)
    assert np.array_equal(first, first.T)
    assert np.linalg.eigvalsh(first)[0] > 0.0
    monkeypatch.setattr(compliance, "DirectSolver", None)  # a second start may not factorise
    assert np.array_equal(surface_compliance_m_N(body, free), first)
    with pytest.raises(TypeError):
        surface_compliance_m_N(body_of(law=(6e3, 0.45)), free)


def test_the_compliance_read_off_a_factor_is_that_of_back_substitutions(monkeypatch, tmp_path):
    """The compliance read off a factor equals that of back substitutions.

    Held nodes among the touchable ones give zero; the difference is rounding of two factors in
    different orders.
    """
    body = body_of()
    shares = []
    read = surface_compliance_m_N(body, SURFACE)
    monkeypatch.setattr(compliance, "SCHUR_UNKNOWNS", 0)
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path / "other"))
    solved = surface_compliance_m_N(body, SURFACE, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    np.testing.assert_allclose(read, solved, atol=1e-12 * np.abs(solved).max())
    np.testing.assert_array_equal(read, read.T)
    assert (np.diag(read) == 0.0).any() and np.diag(read).max() > 0.0


def test_a_compliance_that_would_not_fit_is_refused_beforehand():
    body = body_of()
    needed = 8 * (3 * len(SURFACE)) ** 2
    assert surface_compliance_m_N(body, SURFACE, limit_bytes=needed).nbytes == needed
    with pytest.raises(InputError, match="touchable"):
        surface_compliance_m_N(body, SURFACE, limit_bytes=needed - 1)
