"""Equilibria under nodal forces that change.

They are compared with uniaxial closed forms and with balanced forces.
"""

import pickle

import numpy as np
import pytest
from scipy.optimize import brentq

from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.fields import principal_stresses, von_mises
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton, Springs
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.fields import cauchy_stress

SIDE_M = 0.03
LAME = lame(5e3, 0.45)
LAW = Hyperelastic.yeoh(
    0.5 * LAME[1], 0.1 * LAME[1], 0.02 * LAME[1], bulk_Pa=LAME[0] + 2.0 / 3.0 * LAME[1]
)


def cube(order: int) -> tuple[Space, HeldBody, QuasiNewton]:
    """A cube on three planes of symmetry, and what follows its loads."""
    space = Space(box((SIDE_M,) * 3, (2, 2, 2)), order)
    body = HeldBody(assemble(space, LAME), space.nodes_m, np.abs(space.nodes_m) < 1e-12)

    def solver_of(stiffness):
        return DirectSolver(HeldBody(stiffness, space.nodes_m, body.fixed))

    return (
        space,
        body,
        QuasiNewton(
            NonlinearBody(space, law=LAW), body.fixed, solver_of(body.stiffness), solver_of
        ),
    )


def pulled(space: Space, force_N: float) -> np.ndarray:
    """Return a force along x, spread evenly over the face at the largest x."""
    face = np.isclose(space.nodes_m[space.faces], SIDE_M, atol=1e-12)[:, :, 0].all(axis=1)
    load = np.zeros((space.node_count, 3))
    share = (
        np.full(3, 1.0 / 3.0)
        if space.order == 1
        else np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) / 3.0
    )
    each = np.tile(force_N / face.sum() * share, face.sum())
    load[:, 0] = np.bincount(space.faces[face].ravel(), weights=each, minlength=space.node_count)
    return load


SOFTENING = Hyperelastic.yeoh(0.5 * LAME[1], -0.04 * LAME[1], 0.0, bulk_Pa=LAW.bulk_Pa)
"""Law whose force along a bar is largest at a stretch of 2.0 and falls beyond it.

No load alone holds the bar beyond.
"""


def softening_bar() -> tuple[Space, HeldBody, QuasiNewton, NonlinearBody]:
    """A cube of that law, whose tangents are refused where they are not positive definite."""
    space = Space(box((SIDE_M,) * 3, (1, 1, 1)), 2)
    held = HeldBody(assemble(space, LAME), space.nodes_m, np.abs(space.nodes_m) < 1e-12)
    nodes = np.arange(27)

    def solver_of(stiffness):
        return DirectSolver(HeldBody(stiffness, space.nodes_m, held.fixed), last=nodes)

    body = NonlinearBody(space, law=SOFTENING)
    return space, held, QuasiNewton(body, held.fixed, solver_of(held.stiffness), solver_of), body


def softening_N(along: float) -> tuple[float, np.ndarray]:
    """Force along that bar [N] and its stretches, by the law's own derivatives."""
    side = brentq(
        lambda side: SOFTENING.stress(np.diag([along, side, side]))[1, 1], 0.3, 3.0, xtol=1e-14
    )
    return SOFTENING.stress(np.diag([along, side, side]))[0, 0] * SIDE_M**2, np.array(
        [along, side, side]
    )


def stretched(force_N: float) -> tuple[float, float]:
    """Return the stretch along and across a bar under a nominal stress along it.

    The law's own derivatives are used.
    """

    def across(along):
        return brentq(
            lambda side: LAW.stress(np.diag([along, side, side]))[1, 1], 0.3, 3.0, xtol=1e-14
        )

    along = brentq(
        lambda s: LAW.stress(np.diag([s, across(s), across(s)]))[0, 0] - force_N / SIDE_M**2,
        0.4,
        3.0,
    )
    return along, across(along)


@pytest.mark.parametrize("order", [1, 2])
def test_a_bar_stretches_and_shortens_as_its_law_has_it(order):
    space, _, follower = cube(order)
    for force_N in (0.5, 3.0, 6.0, 2.0, -1.0, -2.0):
        found = follower.follow(pulled(space, force_N), tolerance=1e-9, step_limit=200)
        assert found.residual <= 1e-9
        along, across = stretched(force_N)
        assert found.displacement_m == pytest.approx(
            space.nodes_m * (np.array([along, across, across]) - 1.0), abs=1e-8
        )
        stress = cauchy_stress(space, found.displacement_m, LAW, np.ones(space.cell_count))
        assert stress.stress_Pa[:, 0] == pytest.approx(force_N / (across * SIDE_M) ** 2, rel=1e-6)
        assert stress.strain[:, 0] == pytest.approx(np.log(along), rel=1e-6)
        assert von_mises(stress.stress_Pa) == pytest.approx(
            abs(force_N) / (across * SIDE_M) ** 2, rel=1e-5
        )


def test_taken_off_the_load_leaves_nothing():
    space, _, follower = cube(2)
    follower.follow(pulled(space, 6.0), tolerance=1e-6, step_limit=100)
    found = follower.follow(np.zeros((space.node_count, 3)), tolerance=1e-9, step_limit=100)
    assert np.abs(found.displacement_m).max() < 1e-9


def test_springs_hold_a_bar_beyond_the_load_that_it_can_bear():
    """Springs hold a bar beyond its largest load.

    Force and shape on the falling branch agree with the closed form, though the tangent is
    indefinite there.
    """
    space, held, follower, body = softening_bar()
    face = np.flatnonzero(np.isclose(space.nodes_m[:, 0], SIDE_M))
    forces_N = []
    for along in (1.5, 1.8, 2.0, 2.02, 2.04, 2.06, 2.08, 2.1, 2.12):
        force_N, stretches = softening_N(along)
        moved_m = space.nodes_m * (stretches - 1.0)
        compliance_m_N = 2e-3 * np.eye(3 * len(face))
        springs = Springs.holding(face, compliance_m_N, moved_m[face], unknowns=moved_m.size)
        # The springs are set off, so that they are not at rest in the equilibrium that is asked
        # for.
        off_N = np.zeros((space.node_count, 3))
        off_N[face, 0] = 0.02 / len(face)
        springs = Springs(springs.root, springs.rest + np.sqrt(2e-3) * off_N[face].ravel())
        found = follower.follow(
            pulled(space, force_N) - off_N, tolerance=1e-9, step_limit=100, springs=springs
        )
        assert found.residual <= 1e-9
        assert found.displacement_m == pytest.approx(moved_m, abs=1e-9)
        assert found.load_N[:, 0].sum() == pytest.approx(force_N, rel=1e-8)
        forces_N.append(force_N)
        free = held.free
        least = np.linalg.eigvalsh(
            body.stiffness(found.displacement_m).toarray()[np.ix_(free, free)]
        )[0]
        assert (least < 0.0) == (along >= 2.0)
        follower.take_stiffness()
        compliance = follower.factor.compliance_between(np.arange(space.node_count))
        assert np.linalg.eigvalsh(compliance[np.ix_(free, free)])[0] > 0.0, (
            "what a contact takes is definite"
        )
    assert forces_N[-1] < max(forces_N), "the last stretches lie on the falling branch"
    assert follower.indefinite >= 7


@pytest.mark.parametrize("along", [1.5, 2.1])
def test_a_restored_solver_continues_bit_for_bit(along):
    """From a tangent that is positive definite and one that was made so, with curvature pairs."""
    space, _, follower, _ = softening_bar()
    force_N, stretches = softening_N(along)
    moved_m = space.nodes_m * (stretches - 1.0)
    face = np.flatnonzero(np.isclose(space.nodes_m[:, 0], SIDE_M))
    springs = Springs.holding(
        face, 2e-3 * np.eye(3 * len(face)), moved_m[face], unknowns=moved_m.size
    )

    def follow(share):
        load_N = pulled(space, share * force_N)
        return follower.follow(load_N, tolerance=1e-4, step_limit=40, springs=springs)

    follower.restart(moved_m)
    follower.take_stiffness()
    assert follower.indefinite == (along > 2.0)
    follow(0.98)
    state = follower.state()
    assert state["memory"]
    solved = []
    for kept in (state, state, pickle.loads(pickle.dumps(state))):
        follower.restore(kept)
        solved.append(follow(0.95))
    for found in solved[1:]:
        np.testing.assert_array_equal(found.displacement_m, solved[0].displacement_m)
        assert found.steps == solved[0].steps > 0


def test_springs_have_the_compliance_they_are_given():
    """Springs push with the inverse of their compliance, and with a part of it at a part of the distance."""
    space, _, _, _ = softening_bar()
    random = np.random.default_rng(3)
    nodes = np.array([5, 2, 7])
    root = random.normal(size=(9, 9))
    compliance = 1e-3 * (root @ root.T + np.eye(9))
    target, moved = random.normal(size=(2, 3, 3)) * 1e-3
    there = np.zeros((space.node_count, 3))
    there[nodes] = moved
    springs = Springs.holding(nodes, compliance, target, unknowns=there.size)
    stretch = (target - moved).ravel()
    push = np.linalg.solve(compliance, stretch)
    energy, force = springs.energy_and_force(there)
    assert force[nodes].ravel() == pytest.approx(push, rel=1e-9)
    assert energy == pytest.approx(0.5 * push @ stretch, rel=1e-9)
    part = springs.at(0.25, there).energy_and_force(there)[1]
    assert part[nodes].ravel() == pytest.approx(0.25 * push, rel=1e-9)


def test_a_change_of_load_is_followed_in_parts():
    """A load that is too large for one try is reached in parts of it.

    Two steps are too few for the whole change, and enough for a part.
    """
    space, _, follower = cube(2)
    load = pulled(space, 6.0)
    whole = follower.follow(load, tolerance=1e-3, step_limit=3)
    assert whole.reached < 1.0
    assert whole.residual > 1e-3
    later = follower.follow(load, tolerance=1e-3, step_limit=60)
    assert later.reached == 1.0
    along, across = stretched(6.0)
    expected = space.nodes_m * (np.array([along, across, across]) - 1.0)
    assert later.displacement_m == pytest.approx(expected, abs=1e-2 * np.abs(expected).max())


def test_a_load_that_nothing_balances_leaves_the_last_equilibrium():
    """A load without equilibrium leaves the last equilibrium.

    A softening bar has none under three times its largest force; the follower continues from its
    last state.
    """
    space, _, follower, _ = softening_bar()
    for along, factor in ((1.5, 1.0), (1.5, 4.0), (1.6, 1.0)):
        force_N, stretches = softening_N(along)
        found = follower.follow(pulled(space, factor * force_N), tolerance=1e-9, step_limit=60)
        if factor > 1.0:
            assert found.residual > 0.1
            assert found.reached < 1.0
            assert np.isfinite(found.displacement_m).all()
        else:
            assert found.residual <= 1e-9
            assert found.displacement_m == pytest.approx(
                space.nodes_m * (stretches - 1.0), abs=1e-9
            )


def test_a_solve_of_no_steps_reports_what_is_left():
    space, _, follower = cube(1)
    found = follower.follow(pulled(space, 6.0), tolerance=1e-6, step_limit=0)
    assert found.steps == 0
    assert found.residual == 1.0


def test_turned_tissue_has_the_stress_turned():
    space = Space(box((SIDE_M,) * 3, (1, 1, 1)), 2)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stretch = np.diag([1.3, 0.9, 1.1])
    factors = np.linspace(0.5, 2.0, space.cell_count)
    plain, turned = (
        cauchy_stress(space, space.nodes_m @ (gradient - np.eye(3)).T, LAW, factors)
        for gradient in (stretch, turn @ stretch)
    )
    assert turned.stress_Pa[:, [1, 0, 2]] == pytest.approx(plain.stress_Pa[:, :3], rel=1e-9)
    for of in (principal_stresses, von_mises):
        assert of(turned.stress_Pa) == pytest.approx(of(plain.stress_Pa), rel=1e-9)
    rigid = cauchy_stress(space, space.nodes_m @ (turn - np.eye(3)).T, LAW, factors)
    assert np.abs(rigid.stress_Pa).max() < 1e-9 * LAME[1]
