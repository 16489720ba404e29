"""Equilibria under nodal forces that change, against uniaxial closed forms and against forces that are balanced."""

import numpy as np
import pytest
from scipy.optimize import brentq

from meshes.base.errors import InputError
from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.large_fields import cauchy_stress

SIDE_M = 0.03
LAME = lame(5e3, 0.45)
LAW = Hyperelastic.yeoh(0.5 * LAME[1], 0.1 * LAME[1], 0.02 * LAME[1], bulk_Pa=LAME[0] + 2.0 / 3.0 * LAME[1])


def cube(order: int) -> tuple[Space, HeldBody, QuasiNewton]:
    """A cube on three planes of symmetry, and what follows its loads."""
    space = Space(box((SIDE_M,) * 3, (2, 2, 2)), order)
    body = HeldBody(assemble(space, LAME), space.nodes_m, np.abs(space.nodes_m) < 1e-12)

    def solver_of(stiffness):
        return DirectSolver(HeldBody(stiffness, space.nodes_m, body.fixed))

    return (
        space,
        body,
        QuasiNewton(NonlinearBody(space, None, law=LAW), body.fixed, solver_of(body.stiffness), solver_of),
    )


def pulled(space: Space, force_N: float) -> np.ndarray:
    """A force along x, spread evenly over the face at the greatest x."""
    face = np.isclose(space.nodes_m[space.faces], SIDE_M, atol=1e-12)[:, :, 0].all(axis=1)
    load = np.zeros((space.node_count, 3))
    share = np.full(3, 1.0 / 3.0) if space.order == 1 else np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) / 3.0
    each = np.tile(force_N / face.sum() * share, face.sum())
    load[:, 0] = np.bincount(space.faces[face].ravel(), weights=each, minlength=space.node_count)
    return load


def stretched(force_N: float) -> tuple[float, float]:
    """Stretch along and across a bar under a nominal stress along it, by the law's own derivatives."""

    def across(along):
        return brentq(lambda side: LAW.stress(np.diag([along, side, side]))[1, 1], 0.3, 3.0, xtol=1e-14)

    along = brentq(lambda s: LAW.stress(np.diag([s, across(s), across(s)]))[0, 0] - force_N / SIDE_M**2, 0.4, 3.0)
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
        assert stress.von_mises_Pa == pytest.approx(abs(force_N) / (across * SIDE_M) ** 2, rel=1e-5)


def test_taken_off_the_load_leaves_nothing():
    space, _, follower = cube(2)
    follower.follow(pulled(space, 6.0), tolerance=1e-6, step_limit=100)
    found = follower.follow(np.zeros((space.node_count, 3)), tolerance=1e-9, step_limit=100)
    assert np.abs(found.displacement_m).max() < 1e-9


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
    assert turned.principal_Pa == pytest.approx(plain.principal_Pa, rel=1e-9)
    assert turned.von_mises_Pa == pytest.approx(plain.von_mises_Pa, rel=1e-9)
    rigid = cauchy_stress(space, space.nodes_m @ (turn - np.eye(3)).T, LAW, factors)
    assert np.abs(rigid.stress_Pa).max() < 1e-9 * LAME[1]


def test_factors_of_cells_are_refused_where_they_are_none():
    space = Space(box((SIDE_M,) * 3, (1, 1, 1)), 1)
    with pytest.raises(InputError, match="cell_factors must be positive"):
        NonlinearBody(space, None, law=LAW, cell_factors=np.zeros(space.cell_count))
    with pytest.raises(InputError, match="cell_factors must be None without a hyperelastic law"):
        from tissue.fem.hyperelastic import Law

        NonlinearBody(space, LAME, law=Law.NEO_HOOKEAN, cell_factors=np.ones(space.cell_count))
