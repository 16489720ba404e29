"""Nonlinear equilibria and the limits of linear elasticity.

The states are homogeneous ones, large rotation and contact of a sphere.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.tets.structured import box, graded, grid
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import NewtonSolver, RigidSphere
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

LIVER = lame(5e3, 0.45)
RADIUS_M = 0.01
TURNING = (Law.COROTATIONAL, Law.NEO_HOOKEAN)


def shaken_box(order: int, seed: int = 0) -> Space:
    """A box whose inner nodes are moved by up to a sixth of a side."""
    mesh = box((0.03, 0.03, 0.03), (3, 3, 3))
    inner = ((mesh.nodes_m > 1e-9) & (mesh.nodes_m < 0.03 - 1e-9)).all(axis=1)
    nodes = mesh.nodes_m + inner[:, None] * np.random.default_rng(seed).uniform(
        -1.6e-3, 1.6e-3, mesh.nodes_m.shape
    )
    return Space(TetMesh(nodes, mesh.cells), order)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", list(Law))
def test_patch(law, order):
    """A large affine motion of the surface is followed inside exactly.

    The error is 1e-9 of it; the allowed residual is 1e-11.
    """
    space = shaken_box(order)
    turn = np.eye(3) if law is Law.LINEAR else Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    f = turn @ np.array([[1.15, 0.1, 0.0], [0.0, 0.9, 0.05], [0.05, 0.0, 0.95]])
    goal = space.nodes_m @ (f - np.eye(3)).T
    held = np.zeros(goal.shape, dtype=bool)
    held[np.unique(space.faces)] = True
    solver = NewtonSolver(NonlinearBody(space, LIVER, law=law), held, tolerance=1e-11)
    found = None
    for share in (0.5, 1.0):
        solution = solver.solve(share * goal, start_m=found)
        assert solution.outcome is SolverOutcome.CONVERGED
        found = solution.displacement_m
    np.testing.assert_allclose(found, goal, atol=1e-9 * np.abs(goal).max())


def test_large_rotation(capsys):
    """A large rotation gives no stress in the nonlinear laws.

    The ends of a bar are turned together by 60 degrees in steps; the linear law finds a false
    stress.
    """
    space = Space(box((0.06, 0.015, 0.015), (6, 2, 2)))
    ends = (space.nodes_m[:, 0] < 1e-9) | (space.nodes_m[:, 0] > 0.06 - 1e-9)
    held = np.repeat(ends[:, None], 3, axis=1)
    stretched = {}
    for law in Law:
        solver, moved = NewtonSolver(NonlinearBody(space, LIVER, law=law), held), None
        for angle in np.deg2rad(np.arange(10.0, 61.0, 10.0)):
            turn = Rotation.from_rotvec([0.0, 0.0, angle])
            solution = solver.solve(turn.apply(space.nodes_m) - space.nodes_m, start_m=moved)
            assert solution.converged
            moved = solution.displacement_m
        area, pull = 0.015**2, np.abs(solution.force_N[space.nodes_m[:, 0] < 1e-9].sum(axis=0))
        stretched[law] = float(np.linalg.norm(pull)) / area
        if law in TURNING:
            np.testing.assert_allclose(moved, turn.apply(space.nodes_m) - space.nodes_m, atol=1e-9)
    # The linear law takes the turn for a compression by 1 - cos(60 degrees) = 0.5: thousands of
    # pascals at E = 5 kPa.
    assert max(stretched[law] for law in TURNING) < 1e-4 and stretched[Law.LINEAR] > 1e3
    with capsys.disabled():
        print(
            "\nfalse stress of the linear law in a bar turned by 60 degrees: "
            f"{stretched[Law.LINEAR] / 5e3:.0%} of E"
        )


def block(
    order: int = 1, *, first: float, growth: float = 1.4, deep: float = 0.05
) -> tuple[Space, np.ndarray]:
    """Return a quarter of a block and its base.

    It is twice as wide as deep, and fine at its top corner (the axis of the sphere).
    """
    aside = graded(0.0, deep, first, growth)
    space = Space(grid(aside, aside, graded(0.0, -deep, first, growth)[::-1]), order)
    return space, space.nodes_m[:, 2] < -deep + 1e-9


def quarter_solver(space: Space, base: np.ndarray, law: Law, **options) -> NewtonSolver:
    """Base held, and the planes of symmetry."""
    held = (np.abs(space.nodes_m) < 1e-12) & np.array([True, True, False])
    held[base] = True
    return NewtonSolver(NonlinearBody(space, LIVER, law=law), held, **options)


@pytest.mark.parametrize("law", list(Law))
def test_sphere_contact(law):
    """Contact with a sphere obeys Signorini's conditions to the sphere's tolerance.

    It is in equilibrium with the supports, and the penalty has no influence.
    """
    space, base = block(first=3e-3)
    solver = quarter_solver(space, base, law)
    top = np.flatnonzero(space.nodes_m[:, 2] > -1e-12)
    compliance = solver.rest_diagonal.reshape(-1, 3)[top].mean(axis=1)
    forces = []
    for stiffer in (3.0, 30.0):
        sphere = RigidSphere(
            top, stiffer * compliance, radius_m=RADIUS_M, centre_m=(0.0, 0.0, RADIUS_M - 5e-3)
        )
        solution = solver.solve(sphere=sphere)
        assert solution.outcome is SolverOutcome.CONVERGED
        away = np.linalg.norm(
            space.nodes_m[top] + solution.displacement_m[top] - sphere.centre_m, axis=1
        )
        push = np.linalg.norm(solution.force_N[top], axis=1)
        pressed = push > 1e-6 * push.max()
        assert pressed.sum() > 5 and away.min() > RADIUS_M * (1.0 - 1.1e-6)
        assert away[pressed & ~solver.held[top].any(axis=1)].max() < RADIUS_M * (1.0 + 1.1e-6)
        assert solution.force_N[base, 2].sum() == pytest.approx(solution.tool_force_N[2], rel=1e-6)
        forces.append(solution.tool_force_N[2])
    # Nodes may lie 1e-6 of the radius, 2e-6 of the depth, off: the force follows to about as much.
    assert forces[0] == pytest.approx(forces[1], rel=1e-5)
