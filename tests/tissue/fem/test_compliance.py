"""Compliance of touchable nodes: whole, and column by column on demand."""

import threading
import time

import numpy as np
import pytest
from held_cube import BOTTOM, SURFACE, body_of

from meshes.base.errors import InputError
from tissue.fem.solvers import compliance
from tissue.fem.solvers.compliance import LazyCompliance, surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver


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


def lazy(nodes, **options):
    return LazyCompliance(DirectSolver(body_of()), nodes, **options)


def ready(there, nodes):
    """Return True if the columns of all these nodes are in the buffer."""
    return bool((there._slot[nodes] >= 0).all())


def test_a_node_asked_for_again_while_it_is_found_is_kept_once():
    """A node that is asked for again during its solve is kept once.

    The thread has taken it off the list and is at work when the next tick asks for the node again.
    """
    there = lazy(SURFACE)
    there.want(np.arange(len(SURFACE)))
    node = there._next()
    there.want(np.arange(len(SURFACE)))
    there._find(node)
    there.fill()
    assert ready(there, np.arange(len(SURFACE)))
    assert len(there._used) == len(set(there._slot.tolist())) == len(SURFACE)


def test_columns_on_demand_are_poured_one_node_at_a_time_into_a_matrix_of_all():
    there = lazy(SURFACE)
    whole = surface_compliance_m_N(body_of(), SURFACE)
    matrix = np.full((3 * len(SURFACE),) * 2, np.nan)
    for near in ([5, 9, 30], [9, 31]):
        there.want(np.array(near))
        assert not ready(there, near)
        there.fill()
        while there.pour(matrix):
            pass
    rows = (3 * np.array([5, 9, 30, 31])[:, None] + np.arange(3)).ravel()
    block = matrix[np.ix_(rows, rows)]
    assert np.array_equal(block, block.T)
    assert np.abs(block - whole[np.ix_(rows, rows)]).max() < 1e-12 * np.abs(whole).max()
    assert np.isnan(matrix).sum() == matrix.size - len(rows) ** 2
    assert there.pour(matrix) == 0


def test_the_least_recently_used_node_is_evicted():
    each = 3 * 3 * 8 * len(SURFACE)
    there = lazy(SURFACE, capacity_bytes=3 * each + 5)
    assert there.capacity == 3
    for near in ([0, 1, 2], [0], [3]):
        there.want(np.array(near))
        there.fill()
    assert ready(there, np.array([0, 2, 3])) and not ready(there, np.array([1]))
    there.want(np.array([0, 2, 4]))
    there.fill()
    assert ready(there, np.array([0, 2, 4]))  # what is wanted stays whatever its age
    with pytest.raises(InputError):
        there.want(np.arange(4))


def test_a_thread_finds_columns_in_the_background_and_drops_what_is_no_longer_wanted():
    there = lazy(SURFACE)
    there.start()
    try:
        there.want(np.arange(60))
        there.want(np.array([70, 71]))
        deadline = time.monotonic() + 20.0
        while not ready(there, np.array([70, 71])):
            assert time.monotonic() < deadline
            time.sleep(0.001)
        assert not ready(there, np.arange(60))
    finally:
        there.stop()
    assert not [thread for thread in threading.enumerate() if thread.name == "compliance"]
    there.want(np.array([72]))
    there.fill()
    assert ready(there, np.array([71, 72]))


def test_a_failure_in_the_thread_is_refused(monkeypatch):
    there = lazy(SURFACE)
    monkeypatch.setattr(there._solver, "columns", lambda unknowns: 1 / 0)
    there.start()
    there.want(np.array([1]))
    there._thread.join(timeout=20.0)
    with pytest.raises(RuntimeError, match="the compliance could not be found"):
        there.pour(np.full((3 * len(SURFACE),) * 2, np.nan))
    there.stop()
