"""Nonlinear equilibria of quadratic and linear cells: homogeneous states and large rotation."""

import numpy as np
import pytest
from newton_press import NewtonSolver
from scipy.spatial.transform import Rotation

from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic

LIVER = lame(5e3, 0.45)
LAW = Hyperelastic.neo_hookean(LIVER[1], bulk_Pa=float(LIVER[0] + 2.0 / 3.0 * LIVER[1]))


def shaken_box(order: int, seed: int = 0) -> Space:
    """A box whose inner nodes are moved by up to a sixth of a side."""
    mesh = box((0.03, 0.03, 0.03), (3, 3, 3))
    inner = ((mesh.nodes_m > 1e-9) & (mesh.nodes_m < 0.03 - 1e-9)).all(axis=1)
    nodes = mesh.nodes_m + inner[:, None] * np.random.default_rng(seed).uniform(
        -1.6e-3, 1.6e-3, mesh.nodes_m.shape
    )
    return Space(TetMesh(nodes, mesh.cells), order)


@pytest.mark.parametrize("order", [1, 2])
def test_patch(order):
    """A large affine motion of the surface is followed inside exactly.

    The error is 1e-9 of it; the allowed residual is 1e-11.
    """
    space = shaken_box(order)
    turn = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    f = turn @ np.array([[1.15, 0.1, 0.0], [0.0, 0.9, 0.05], [0.05, 0.0, 0.95]])
    goal = space.nodes_m @ (f - np.eye(3)).T
    held = np.zeros(goal.shape, dtype=bool)
    held[np.unique(space.faces)] = True
    solver = NewtonSolver(NonlinearBody(space, law=LAW), held, tolerance=1e-11)
    found = None
    for share in (0.5, 1.0):
        solution = solver.solve(share * goal, start_m=found)
        assert solution.outcome is SolverOutcome.CONVERGED
        found = solution.displacement_m
    np.testing.assert_allclose(found, goal, atol=1e-9 * np.abs(goal).max())


def test_large_rotation():
    """The ends of a bar are turned together by 60 degrees in steps, which gives no stress."""
    space = Space(box((0.06, 0.015, 0.015), (6, 2, 2)))
    ends = (space.nodes_m[:, 0] < 1e-9) | (space.nodes_m[:, 0] > 0.06 - 1e-9)
    held = np.repeat(ends[:, None], 3, axis=1)
    solver, moved = NewtonSolver(NonlinearBody(space, law=LAW), held), None
    for angle in np.deg2rad(np.arange(10.0, 61.0, 10.0)):
        turn = Rotation.from_rotvec([0.0, 0.0, angle])
        goal = turn.apply(space.nodes_m) - space.nodes_m
        solution = solver.solve(goal, start_m=moved)
        assert solution.converged
        moved = solution.displacement_m
    pull = np.abs(solution.force_N[space.nodes_m[:, 0] < 1e-9].sum(axis=0))
    assert np.linalg.norm(pull) / 0.015**2 < 1e-4
    np.testing.assert_allclose(moved, goal, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_stiffness_at_rest_is_that_of_linear_cells(order):
    """The two assemblies are independent; the difference is rounding."""
    space = shaken_box(order)
    rest = NonlinearBody(space, law=LAW).stiffness(np.zeros(space.nodes_m.shape)).toarray()
    linear = assemble(space, LIVER).toarray()
    np.testing.assert_allclose(rest, linear, atol=1e-12 * np.abs(linear).max())
