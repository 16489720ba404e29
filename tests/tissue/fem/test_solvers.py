"""Laws that every path to ``K u = f`` keeps, what each refuses, and every outcome of a solve."""

import numpy as np
import pytest
from held_cube import BOTTOM, MESH, SURFACE, body_of, energy_error, load_on
from round_bodies import joined
from scipy.sparse import bsr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from meshes.base.errors import InputError
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.solvers.direct import DirectSolver, dissected
from tissue.fem.solvers.held_body import (
    HeldBody,
    free_motion_count,
    held_nodes,
    pointwise_graph,
)
from tissue.fem.solvers.multigrid import MultigridSolver


@pytest.fixture(autouse=True)
def fresh_cache(tmp_path, monkeypatch):
    """A cache of its own for every test."""
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))


PATHS = {"direct": DirectSolver, "multigrid": MultigridSolver}


def sliding():
    """The bottom may slide but for three planes that keep it."""
    x = MESH.nodes_m
    return np.abs(x) < 1e-9


HELD = {"clamped": lambda: held_nodes(BOTTOM), "sliding": sliding}


def dense(body, load):
    """The answer by LAPACK."""
    full = body.stiffness.toarray()
    fixed = body.fixed.ravel()
    answer = np.zeros(len(full))
    answer[~fixed] = np.linalg.solve(full[np.ix_(~fixed, ~fixed)], load.ravel()[~fixed])
    return answer.reshape(-1, 3)


@pytest.fixture(params=PATHS)
def path(request):
    return PATHS[request.param]


@pytest.mark.parametrize("held", HELD)
def test_the_answer_is_lapacks_to_the_stated_tolerance(path, held):
    body = body_of(fixed=HELD[held]())
    solver = path(body)
    load = load_on(SURFACE)
    found = solver.solve(load)
    assert found.outcome is SolverOutcome.CONVERGED and found.converged
    assert energy_error(body, found.displacement_m, dense(body, load)) <= solver.tolerance
    assert np.all(found.displacement_m[body.fixed] == 0.0)


def test_a_solve_is_linear_reciprocal_and_stores_energy(path):
    """A solve is linear, reciprocal and stores energy.

    Betti (1872): the work of one load along another's displacement is equal in either order.
    """
    body = body_of()
    solver = path(body)
    free = SURFACE[~BOTTOM[SURFACE]]
    loads = [load_on(free, seed) for seed in (1, 2)]
    a, b = (solver.solve(load).displacement_m for load in loads)
    both = solver.solve(2.0 * loads[0] - 3.0 * loads[1]).displacement_m
    slack = 20.0 * max(solver.tolerance, 1e-12)  # errors of three solves, in any direction
    assert np.linalg.norm(both - (2.0 * a - 3.0 * b)) <= slack * np.linalg.norm(both)
    one = np.sum(loads[0] * b)
    other = np.sum(loads[1] * a)
    size = np.sqrt(np.sum(loads[0] * a) * np.sum(loads[1] * b))
    assert abs(one - other) <= slack * size
    assert np.sum(loads[0] * a) > 0.0 and np.sum(loads[1] * b) > 0.0


def test_a_load_that_is_no_number_or_of_another_shape_is_refused():
    load = load_on(SURFACE)
    load[SURFACE[4], 1] = np.nan
    for bad in (load, np.zeros((124, 3))):
        with pytest.raises(InputError, match="load_N"):
            DirectSolver(body_of()).solve(bad)


@pytest.mark.parametrize(
    ("nodes", "axes", "count"),
    [
        ([0], "xyz", 3),
        ([0, 1, 2, 3, 4], "xyz", 1),
        (np.flatnonzero(BOTTOM), "z", 3),
        (np.flatnonzero(BOTTOM), "yz", 1),
    ],
    ids=["one node", "an edge", "a plane that slides", "a rail"],
)
def test_free_motions_are_counted(nodes, axes, count):
    fixed = np.zeros(MESH.nodes_m.shape, dtype=bool)
    for axis in axes:
        fixed[nodes, "xyz".index(axis)] = True
    regular = box((1.0, 1.0, 1.0), (4, 4, 4)).nodes_m
    assert free_motion_count(regular, fixed) == count
    with pytest.raises(InputError, match="supports"):
        body_of(fixed=fixed)


def test_supports_that_hold_nothing_are_refused():
    loose = TetMesh(np.concatenate([MESH.nodes_m, [[2.0, 0.0, 0.0]]]), MESH.cells)
    fixed = np.zeros(len(loose.nodes_m), dtype=bool)
    fixed[-1] = True
    far = TetMesh(MESH.nodes_m + np.array([3.0, 0.0, 0.5]), MESH.cells)
    for bad in (
        lambda: body_of(fixed=np.zeros(MESH.nodes_m.shape, dtype=bool)),
        lambda: body_of(loose, held_nodes(fixed)),
        lambda: body_of(joined([MESH, far])),
    ):
        with pytest.raises(InputError, match="supports"):
            bad()


@pytest.mark.parametrize("solver", [DirectSolver, MultigridSolver])
def test_nodes_of_no_cell_stay_where_they_are(solver):
    loose = TetMesh(np.concatenate([MESH.nodes_m, [[2.0, 0.0, 9.0]]]), MESH.cells)
    body = body_of(loose)
    load = np.concatenate([load_on(SURFACE), np.zeros((1, 3))])
    found = solver(body).solve(load)
    assert found.converged and not found.displacement_m[-1].any()
    assert np.abs(found.displacement_m[:-1] - dense(body_of(), load[:-1])).max() < 1e-6
    load[-1] = 1.0
    with pytest.raises(InputError, match="load_N must act on nodes of cells"):
        solver(body).solve(load)


def test_an_indefinite_stiffness_is_reported():
    """Shifted by more than its lowest eigenvalue, K keeps a positive diagonal."""
    body = body_of()
    free = body.free
    values, vectors = np.linalg.eigh(body.stiffness.toarray()[np.ix_(free, free)])
    shifted = bsr_array(
        (body.stiffness - 1.5 * values[0] * eye_array(body.stiffness.shape[0])).tobsr((3, 3))
    )
    assert shifted.diagonal().min() > 0.0
    indefinite = HeldBody(shifted, MESH.nodes_m, body.fixed)
    found = MultigridSolver(indefinite).solve(body.whole(vectors[:, 0]))
    assert found.outcome is SolverOutcome.INDEFINITE and not found.converged
    with pytest.raises(InputError, match="stiffness"):
        DirectSolver(indefinite)


def test_multigrid_that_runs_out_of_iterations_is_reported():
    found = MultigridSolver(body_of(), limit=2).solve(load_on(SURFACE))
    assert found.outcome is SolverOutcome.NOT_CONVERGED and found.iterations == 2


def test_dissection_orders_every_node_once_and_parts_what_it_separates():
    """Dissection orders every node once and separates the parts.

    Without the last nodes, a box falls apart into halves; elimination in that order has less fill
    than the plain order.
    """
    mesh = box((1.0, 0.5, 0.5), (16, 6, 6))
    body = body_of(mesh)
    graph = pointwise_graph(body.stiffness)
    order = np.concatenate(dissected(mesh.nodes_m, graph))
    assert np.array_equal(np.sort(order), np.arange(len(mesh.nodes_m)))
    section = 7 * 7
    left = order[:-section]
    count, label = connected_components(graph[left][:, left], directed=False)
    assert count == 2 and np.bincount(label).min() > 0.4 * len(left)
    rows = body.stiffness.tocsr()
    unknowns = (3 * order[:, None] + np.arange(3)).ravel()
    free = np.isin(unknowns, body.free)
    mixed = np.random.default_rng(0).permutation(body.free)
    fills = [
        splu(
            rows[o][:, o].tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).nnz
        for o in (unknowns[free], mixed)
    ]
    assert fills[0] < 0.5 * fills[1]
