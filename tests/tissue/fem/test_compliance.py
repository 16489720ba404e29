"""Compliance of touchable nodes: whole, column by column on demand, and cut to a basis of modes."""

import threading
import time

import numpy as np
import pytest
from basis_error import basis_error
from held_cube import BOTTOM, SURFACE, body_of, energy_error, load_on

from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.solvers import condensed
from tissue.fem.solvers.condensed import compliance_bytes, surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.lazy_compliance import LazyCompliance
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.fem.solvers.reduced import ReducedSolver


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
    monkeypatch.setattr(condensed, "DirectSolver", None)  # a second start may not factorise
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
    monkeypatch.setattr(condensed, "SCHUR_UNKNOWNS", 0)
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path / "other"))
    solved = surface_compliance_m_N(body, SURFACE, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    np.testing.assert_allclose(read, solved, atol=1e-12 * np.abs(solved).max())
    np.testing.assert_array_equal(read, read.T)
    assert (np.diag(read) == 0.0).any() and np.diag(read).max() > 0.0


def test_a_compliance_that_would_not_fit_is_refused_beforehand():
    body = body_of()
    needed = compliance_bytes(len(SURFACE))
    assert surface_compliance_m_N(body, SURFACE, limit_bytes=needed).nbytes == needed
    with pytest.raises(
        InputError, match=r"must fit in .* GB, got 98 nodes that need .*LazyCompliance"
    ):
        surface_compliance_m_N(body, SURFACE, limit_bytes=needed - 1)


@pytest.mark.parametrize(
    ("touchable", "message"),
    [
        ([], "touchable must name at least one node"),
        ([3, 125], "touchable must name nodes 0 to 124, got 3 to 125"),
        ([3, 3, 4], "touchable must name each node once, got 1 twice"),
    ],
)
def test_touchable_nodes_are_checked(touchable, message):
    with pytest.raises(InputError, match=message):
        surface_compliance_m_N(body_of(), np.array(touchable, dtype=np.int64))


def test_multigrid_finds_columns_too_to_its_tolerance():
    body = body_of()
    exact = surface_compliance_m_N(body, SURFACE)
    unknowns = (3 * SURFACE[50:53, None] + np.arange(3)).ravel()
    rows = (3 * SURFACE[:, None] + np.arange(3)).ravel()
    found = MultigridSolver(body).columns(unknowns)[rows]
    assert np.abs(found - exact[:, 150:159]).max() < 1e-7 * np.abs(exact).max()
    with pytest.raises(
        InputError, match="stiffness must have columns by multigrid, got NOT_CONVERGED"
    ):
        MultigridSolver(body, limit=1).columns(unknowns)


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
    with pytest.raises(InputError, match="matrix_m_N must be contiguous"):
        there.pour(matrix[:, ::2])


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
    with pytest.raises(
        InputError, match="nodes must be at most the 3 that the buffer holds, got 4"
    ):
        there.want(np.arange(4))
    with pytest.raises(InputError, match="capacity_bytes must hold one node"):
        lazy(SURFACE, capacity_bytes=each - 1)


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


def test_modes_are_orthonormal_in_the_stiffness_and_cut_the_compliance_best():
    body = body_of()
    free = SURFACE[~BOTTOM[SURFACE]]
    solver = ReducedSolver(DirectSolver(body), free, size=20)
    gram = solver.modes.T @ (body.stiffness @ solver.modes)
    assert np.abs(gram - np.eye(20)).max() < 1e-10
    whole = surface_compliance_m_N(body, free)
    rows = (3 * free[:, None] + np.arange(3)).ravel()
    reduced = solver.modes[rows] @ solver.modes[rows].T
    missed = np.linalg.eigvalsh(whole - reduced)
    assert missed[0] > -1e-12 * missed[-1]  # a basis is never softer than the body
    assert missed[-1] == pytest.approx(solver.values_m_N[20], rel=1e-8)


def test_more_modes_leave_out_less_and_the_reported_error_is_the_error():
    body = body_of()
    free = SURFACE[~BOTTOM[SURFACE]]
    factor = DirectSolver(body)
    load = load_on(free[:6])
    exact = factor.solve(load).displacement_m
    reported_errors = []
    for size in (5, 20, 60, 200):
        found = ReducedSolver(factor, free, size=size).solve(load)
        reported_errors.append(found.residual)
        assert found.residual == pytest.approx(
            energy_error(body, found.displacement_m, exact), rel=1e-6
        )
        assert found.converged is (found.residual <= 0.1)
    assert reported_errors == sorted(reported_errors, reverse=True)
    assert reported_errors[0] > 0.1 > reported_errors[-1]
    solver = ReducedSolver(factor, free, size=5)
    left_out = [basis_error(solver, size) for size in (5, 20, 60, 200)]
    for name in ("energy", "point", "corrected"):
        values = [getattr(error, name) for error in left_out]
        assert values == sorted(values, reverse=True) and 0.0 < values[-1] < values[0] <= 1.0


def test_residual_blocks_make_a_single_node_as_soft_as_it_is():
    body = body_of()
    free = SURFACE[~BOTTOM[SURFACE]]
    solver = ReducedSolver(DirectSolver(body), free, size=10)
    whole = surface_compliance_m_N(body, free)
    reduced = solver.compliance_m_N()
    for node in range(0, len(free), 7):
        part = slice(3 * node, 3 * node + 3)
        assert np.abs(reduced[part, part] - whole[part, part]).max() < 1e-12 * np.abs(whole).max()
    assert np.array_equal(reduced, reduced.T)
    # the blocks of what is left out are positive definite
    assert np.linalg.eigvalsh(reduced)[0] > 0.0


def test_a_load_outside_the_basis_is_reported():
    body = body_of()
    solver = ReducedSolver(DirectSolver(body), SURFACE[:20], size=60)
    inside = np.setdiff1d(np.arange(125), SURFACE)
    assert solver.solve(load_on(inside)).outcome is SolverOutcome.OUTSIDE_BASIS


@pytest.mark.parametrize(
    ("options", "message"), [({"size": 0}, "size must be in"), ({"size": 9999}, "size must be in")]
)
def test_a_basis_that_makes_no_sense_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        ReducedSolver(DirectSolver(body_of()), SURFACE, **options)
